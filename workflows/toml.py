"""TOML into frozen structs: every mistake becomes one ConfigError that names the key, the value and what is allowed."""

from __future__ import annotations

import difflib
import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from pipeline.errors import ConfigError

T = TypeVar("T")


def read_toml(path: Path) -> dict[str, Any]:
    """The table of a TOML file.

    Raises
    ------
    ConfigError : the file is missing, unreadable or not TOML.
    """
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ConfigError(
            "no such file", value=str(path), next_step="check the path, or leave it out to use the shipped default"
        ) from None
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"the file cannot be read ({error})", value=str(path)) from error
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{path} is not valid TOML", value=str(error), next_step="mend that line") from error


def to_struct(table: Mapping[str, Any], kind: type[T], where: str) -> T:
    """``table`` as the struct ``kind``.

    Raises
    ------
    ConfigError : an unknown key, a wrong type or a value out of range; ``where`` says in which file.
    """
    try:
        return msgspec.convert(table, kind)
    except msgspec.ValidationError as error:
        raise _explained(str(error), table, kind, where) from error


def _explained(message: str, table: Mapping[str, Any], kind: type[Any], where: str) -> ConfigError:
    clause, _, path = message.partition(" - at `")
    keys = [key for key in re.split(r"[.\[\]]+", path.rstrip("`").removeprefix("$")) if key]
    if clause.endswith("`$`"):
        clause = clause.removesuffix(" - at `$`")
    unknown = re.search(r"unknown field `([^`]*)`", clause)
    shown = ".".join(keys)
    if unknown:
        allowed = _fields(kind, keys)
        near = difflib.get_close_matches(unknown[1], allowed, n=1)
        full = ".".join([*keys, unknown[1]])
        return ConfigError(
            f"unknown key in {where}",
            value=full,
            allowed=", ".join(allowed),
            next_step=f"did you mean {near[0]!r}?" if near else "remove it",
        )
    value: Any = table
    for key in keys:
        try:
            value = value[int(key)] if isinstance(value, list) else value[key]
        except (KeyError, IndexError, TypeError, ValueError):
            value = None
            break
    return ConfigError(
        f"{shown or 'a value'} in {where} is wrong", value=value, allowed=clause.replace("`", ""), next_step="mend it"
    )


def _fields(kind: Any, keys: list[str]) -> list[str]:
    """Field names of the struct that ``keys`` lead to."""
    for key in keys:
        hints = {f.name: f.type for f in msgspec.structs.fields(kind)} if _is_struct(kind) else {}
        kind = hints.get(key, kind)
        options = [a for a in getattr(kind, "__args__", ()) if _is_struct(a)]
        kind = options[0] if options else kind
    return [f.encode_name for f in msgspec.structs.fields(kind)] if _is_struct(kind) else []


def _is_struct(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, msgspec.Struct)
