"""TOML files: read into checked tables, and written.

    load(path, kind, ..)            file   -> kind
    decode(text, kind, where)       bytes  -> kind
    plain_tables(text, where)       bytes  -> tables
    converted(tree, kind, where)    tables -> kind

``kind`` is a msgspec struct that declares the keys, their types and their ranges.  Every fault is one
:class:`ConfigError` that names the file, the key, the value found, what is allowed and the next step.  Numbers must be
finite, except where the type is annotated with ``Meta(extra=MAY_BE_INFINITE)``.
"""

from __future__ import annotations

import difflib
import math
import re
import stat
from collections.abc import Iterable
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from .errors import ConfigError, GyroscreenError, MeasurementError
from .input_limits import TOML_BYTES, TOML_KEY_CHARS, check_path, check_toml
from .toml_faults import MAY_BE_INFINITE as MAY_BE_INFINITE
from .toml_faults import first_fault

T = TypeVar("T", bound=msgspec.Struct)


def read_bytes(
    path: Path, what: str = "the file", next_step: str = "", error: type[GyroscreenError] = MeasurementError
) -> bytes:
    """The content of a TOML file; ``error`` is raised if it cannot be read or is larger than ``TOML_BYTES``.

    ``what`` names the kind of file in the message; ``next_step`` says what to do if it does not exist.
    """
    check_path(path, what, error)
    try:
        found = path.stat()
        if not stat.S_ISREG(found.st_mode) and not stat.S_ISDIR(found.st_mode):
            # Reading a pipe or a device may wait forever.
            raise error(f"{what} is not a regular file", value=str(path), next_step="check that this is the right file")
        if found.st_size > TOML_BYTES:
            raise error(
                f"{what} is too large",
                value=f"{path}: {found.st_size} bytes",
                allowed=f"{TOML_BYTES} bytes",
                next_step="check that this is the right file",
            )
        return path.read_bytes()
    except OSError as reason:
        raise error(
            f"{what} cannot be read: {(reason.strerror or str(reason)).lower()}",
            value=str(path),
            next_step=next_step or "check the path and permissions",
        ) from reason


def load(path: Path, kind: type[T], what: str, otherwise: str) -> T:
    """The TOML file ``path`` as ``kind``.

    ``what`` names the kind of file in messages; ``otherwise`` says what to do if there is no such file.

    Raises
    ------
    ConfigError : the file cannot be read, is not TOML, or has a wrong key or value.
    """
    text = read_bytes(path, what, f"check the path, or {otherwise}", ConfigError)
    return decode(text, kind, path.name)


def decode(text: bytes, kind: type[T], where: str) -> T:
    """``text`` as ``kind``; ``where`` names the file in messages.

    Raises
    ------
    ConfigError : not TOML, or a wrong key or value.
    """
    return converted(plain_tables(text, where), kind, where)


def plain_tables(text: bytes, where: str) -> dict[str, Any]:
    """``text`` as plain tables; ``where`` names the file in messages.

    Raises
    ------
    ConfigError : not TOML, or too large.
    """
    try:
        plain = text.decode()
        if len(text) > TOML_BYTES:  # text that was not read from a file
            raise ConfigError(
                f"{where} is too large",
                value=f"{len(text)} bytes",
                allowed=f"{TOML_BYTES} bytes",
                next_step="check that this is the right file",
            )
        check_toml(plain, where, ConfigError)
        found: dict[str, Any] = msgspec.toml.decode(plain)
        _check_keys(found, where)
    except (ValueError, RecursionError) as error:  # msgspec.DecodeError, UnicodeDecodeError
        raise ConfigError(
            f"{where} is not TOML",
            value=str(error)[:120],
            allowed="TOML 1.0 in UTF-8",
            next_step="correct the line named",
        ) from error
    return found


def _check_keys(tree: Any, where: str) -> None:
    """Check the length of the keys of ``tree``; quoted ones may hold anything.  Messages show keys in full."""
    for name in tree if isinstance(tree, dict) else ():
        if len(name) > TOML_KEY_CHARS:
            raise ConfigError(
                f"{where}: a key is too long",
                value=name[:40],
                allowed=f"at most {TOML_KEY_CHARS} characters",
                next_step="shorten it",
            )
    for value in tree.values() if isinstance(tree, dict) else tree:
        if isinstance(value, dict | list):
            _check_keys(value, where)


def converted(tree: Any, kind: type[T], where: str) -> T:
    """Plain tables as ``kind``; ``where`` names their file in messages.

    Raises
    ------
    ConfigError : a wrong key or value.
    """
    try:
        return _converted(tree, kind, where)
    except RecursionError:
        raise ConfigError(
            f"{where} is nested too deeply",
            allowed="tables and lists as documented",
            next_step="remove nested brackets",
        ) from None


def _converted(tree: Any, kind: type[T], where: str) -> T:
    try:
        found = msgspec.convert(tree, kind)
    except msgspec.ValidationError as error:
        found, reason = None, str(error)
    if found is not None and _finite(tree):
        return found
    fault = first_fault(tree, kind)
    if fault is not None:
        raise ConfigError(
            f"{where}: {fault.what}", value=fault.value, allowed=fault.allowed, next_step=fault.next_step
        ) from None
    if found is None:
        raise ConfigError(f"{where}: {reason}", next_step="correct this key") from None
    return found


def _finite(tree: Any) -> bool:
    if isinstance(tree, dict):
        return all(_finite(value) for value in tree.values())
    if isinstance(tree, list | tuple):
        return all(_finite(value) for value in tree)
    return not isinstance(tree, float) or math.isfinite(tree)


def check_known(name: str, known: Iterable[str], where: str, what: str = "key") -> None:
    """Raise :class:`ConfigError` if ``name`` is not among ``known``.

    For tables whose keys are names of things that are not listed in a struct.  ``where`` names file and table.
    """
    names = list(known)
    if name not in names:
        near = difflib.get_close_matches(name, names, n=1, cutoff=0.5)
        raise ConfigError(
            f"{where}: unknown {what}",
            value=name,
            allowed=", ".join(names) or "none",
            next_step=f"did you mean {near[0]}?" if near else "remove it or correct its name",
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
        items = [f"{key(k)} = {encoded(v)}" for k, v in value.items() if v is not None]
        return "{ " + ", ".join(items) + " }" if items else "{}"
    return "[" + ", ".join(encoded(item) for item in value) + "]"


def key(name: str) -> str:
    """``name`` as a TOML key, quoted where TOML requires it."""
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else encoded(name)


def table(header: str, values: dict[str, Any]) -> str:
    """``[header]`` and its lines; keys with ``None`` are left out, and an empty text if all values are ``None``."""
    lines = [f"{key(name)} = {encoded(value)}" for name, value in values.items() if value is not None]
    return "\n".join([header, *lines] if header else lines) + "\n" if lines else ""
