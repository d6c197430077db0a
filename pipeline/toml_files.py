"""TOML files in and out: msgspec's complaints as :class:`ConfigError`, and the little TOML that the project
writes.
"""

from __future__ import annotations

import difflib
import math
import re
import tomllib
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from .errors import ConfigError, MeasurementError

T = TypeVar("T", bound=msgspec.Struct)
_MAX_BYTES = 2**24


def read_text(path: Path) -> bytes:
    """The bytes of a small file, or a :class:`MeasurementError`."""
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise MeasurementError(
                "too large for a TOML file",
                value=f"{path}: {path.stat().st_size} bytes",
                allowed=f"{_MAX_BYTES} bytes",
                next_step="check that this is the right file",
            )
        return path.read_bytes()
    except OSError as error:
        raise MeasurementError(
            "the file cannot be opened",
            value=f"{path}: {error.strerror}",
            next_step="check the path and permissions",
        ) from error


def read_table(path: Path, what: str, allowed: str, otherwise: str) -> dict[str, Any]:
    """The top table of the TOML file that is called ``what``; whatever hinders is one :class:`ConfigError`.

    ``allowed`` tables and keys; ``otherwise`` says what to do where there is no such file.
    """
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        reason, next_step = (error.strerror or str(error)).lower(), f"check the path, or {otherwise}"
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        reason, next_step = f"not TOML in UTF-8: {error}", "correct the line that is named"
    raise ConfigError(f"{what} cannot be read: {reason}", value=str(path), allowed=allowed, next_step=next_step)


def decode(text: bytes, kind: type[T], where: str) -> T:
    """``text`` as ``kind``; whatever is wrong in it is one :class:`ConfigError`."""
    try:
        tree = msgspec.toml.decode(text)
    except (ValueError, RecursionError) as error:  # msgspec.DecodeError, UnicodeDecodeError
        raise ConfigError(
            f"{where} is not TOML",
            value=str(error)[:120],
            allowed="TOML 1.0",
            next_step="correct the line named",
        ) from error
    return converted(tree, kind, where)


def converted(tree: Any, kind: type[T], where: str) -> T:
    """A TOML table as ``kind``; whatever is wrong in it is one :class:`ConfigError`."""
    try:
        return msgspec.convert(tree, kind)
    except msgspec.ValidationError as error:
        raise _explained(str(error), tree, kind, where) from error


def _value_at(tree: Any, path: str) -> Any:
    """The value at a msgspec path, or ``None`` where the path does not say which one of a list."""
    for name, index in re.findall(r"\.([A-Za-z0-9_]+)|\[(\d*)", path):
        if name and isinstance(tree, dict):
            tree = tree.get(name)
        elif index and isinstance(tree, list) and int(index) < len(tree):
            tree = tree[int(index)]
        else:
            return None
    return tree


def _types_at(kind: Any, path: str) -> list[Any]:
    """The types allowed at a msgspec path such as ``$.instrument`` or ``$.record[...]``."""
    info = msgspec.inspect.type_info(kind)
    for part in re.findall(r"\.([A-Za-z0-9_]+)|(\[)", path):
        options = list(info.types) if isinstance(info, msgspec.inspect.UnionType) else [info]
        if part[1]:
            info = next((o.item_type for o in options if hasattr(o, "item_type")), info)
        else:
            structs = [o for o in options if isinstance(o, msgspec.inspect.StructType)]
            match = [f.type for s in structs for f in s.fields if f.encode_name == part[0]]
            if not match:
                return []
            info = match[0]
    return list(info.types) if isinstance(info, msgspec.inspect.UnionType) else [info]


def _fields(kind: Any, path: str) -> list[str]:
    """Names of the keys allowed at a msgspec path."""
    structs = [o for o in _types_at(kind, path) if isinstance(o, msgspec.inspect.StructType)]
    return [field.encode_name for struct in structs for field in struct.fields]


def _choices(kind: Any, path: str) -> list[str]:
    """The strings allowed at a msgspec path, where they are listed."""
    literals = [o for o in _types_at(kind, path) if isinstance(o, msgspec.inspect.LiteralType)]
    return [str(value) for literal in literals for value in literal.values]


def _explained(message: str, tree: Any, kind: type, where: str) -> ConfigError:
    clause, _, path = message.partition(" - at `")
    path = path.rstrip("`") or "$"
    place = path.lstrip("$").lstrip(".") or "the top level"
    if unknown := re.search(r"unknown field `(.*)`", clause):
        allowed = _fields(kind, path)
        near = difflib.get_close_matches(unknown[1], allowed, n=1)
        return ConfigError(
            f"{where}: unknown key at {place}",
            value=unknown[1],
            allowed=", ".join(allowed),
            next_step=f"did you mean {near[0]}" if near else "remove it or correct its name",
        )
    if missing := re.search(r"missing required field `(.*)`", clause):
        return ConfigError(
            f"{where}: a key is missing at {place}",
            value=missing[1],
            allowed=", ".join(_fields(kind, path)),
            next_step=f"write {missing[1]}" if missing[1] != "record" else 'write [[record]] and file = ".."',
        )
    found, choices = _value_at(tree, path), _choices(kind, path)
    plain = "plain numbers in the unit of the key's name, strings from the documented choices"
    return ConfigError(
        f"{where}: wrong value at {place}",
        value=clause if found is None else found,
        allowed=", ".join(choices) or (plain if found is None else clause),
        next_step=f"correct {place}",
    )


def finite(value: float | None, what: str, where: str) -> None:
    """Raise :class:`ConfigError` for inf and nan, which TOML can write."""
    if value is not None and not math.isfinite(value):
        raise ConfigError(
            f"{where}: {what} is not finite",
            value=value,
            allowed="a finite number",
            next_step=f"correct {what}",
        )


def encoded(value: Any) -> str:
    """A TOML value: string, bool, number, list, or inline table (a dict; keys with ``None`` are left out)."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (int, float)):
        return repr(value) if isinstance(value, int) else repr(float(value))
    if isinstance(value, str):
        # JSON's escapes are a subset of those of a TOML basic string, but for the delete character.
        return msgspec.json.encode(value).decode().replace("\x7f", "\\u007F")
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key(k)} = {encoded(v)}" for k, v in value.items() if v is not None) + " }"
    return "[" + ", ".join(encoded(item) for item in value) + "]"


def key(name: str) -> str:
    """A bare key where TOML allows one."""
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else encoded(name)


def table(header: str, values: dict[str, Any]) -> str:
    """``[header]`` and its lines; nothing where all values are ``None``."""
    lines = [f"{key(name)} = {encoded(value)}" for name, value in values.items() if value is not None]
    return "\n".join([header, *lines] if header else lines) + "\n" if lines else ""
