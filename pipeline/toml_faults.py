"""The first wrong key or value in a TOML table, in the words of a user.

msgspec says that a table does not convert to a struct, but neither names the keys of a dict nor describes a range in words.
"""

from __future__ import annotations

import difflib
import math
import types
from dataclasses import dataclass
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import msgspec
from msgspec import Meta

#: ``Annotated[float, Meta(extra=MAY_BE_INFINITE)]`` allows inf, and nan where the range does not exclude it.
MAY_BE_INFINITE: dict[str, Any] = {"finite": False}


@dataclass(frozen=True)
class Fault:
    """One clause, the value found (``None`` shows none), what is allowed, and what to do."""

    what: str
    value: Any
    allowed: str
    next_step: str


def first_fault(value: Any, kind: Any, key: str = "") -> Fault | None:
    """The first fault of ``value`` as ``kind``, a msgspec type; ``None`` if there is none.

    ``key`` is the dotted key of ``value``; empty at the top level.
    """
    options = members(kind)
    if isinstance(value, dict):
        for option in options:
            if _is_struct(option):
                return _fault_in_struct(value, option, key)
            if get_origin(option) is dict:
                item = get_args(option)[1]
                faults = (first_fault(v, item, f"{key}.{k}" if key else k) for k, v in value.items())
                return next((fault for fault in faults if fault is not None), None)
    if isinstance(value, list | tuple):
        for option in options:
            items = _item_types(option, len(value))
            faults = (first_fault(v, item, f"{key}[{i}]") for i, (v, item) in enumerate(zip(value, items)))
            fault = next((fault for fault in faults if fault is not None), None)
            if fault is not None:
                return fault
    if isinstance(value, float) and not math.isfinite(value) and not _may_be_infinite(kind):
        return Fault(f"{key} is not finite", value, "a finite number", f"correct {key}")
    try:
        msgspec.convert(value, kind)
    except msgspec.ValidationError:
        return Fault(f"{key} is not valid", value, described(kind), f"correct {key}")
    return None


def _fault_in_struct(table: dict[str, Any], kind: type[msgspec.Struct], key: str) -> Fault | None:
    place = f"in {key}" if key else "at the top level"
    fields = {field.encode_name: field for field in msgspec.structs.fields(kind)}
    allowed = ", ".join(fields)
    for name in table if kind.__struct_config__.forbid_unknown_fields else ():
        if name not in fields:
            near = difflib.get_close_matches(name, fields, n=1, cutoff=0.5)
            hint = f"did you mean {near[0]}?" if near else "remove it or correct its name"
            return Fault(f"unknown key {place}", name, allowed, hint)
    for name, field in fields.items():
        if field.required and name not in table:
            base, _ = _bare(field.type)
            hint = f"write [[{name}]] and its keys" if get_origin(base) is list else f"write {name}"
            return Fault(f"a key is missing {place}", name, allowed, hint)
    faults = (
        first_fault(value, fields[name].type, f"{key}.{name}" if key else name)
        for name, value in table.items()
        if name in fields
    )
    return next((fault for fault in faults if fault is not None), None)


def described(kind: Any) -> str:
    """What a msgspec type allows, in words: "a whole number from 1 to 64"."""
    return " or ".join(dict.fromkeys(_words(option) for option in members(kind) if option is not type(None)))


def _words(option: Any) -> str:
    base, meta = _bare(option)
    if meta is not None and meta.description:
        return meta.description
    if base is bool:
        return "true or false"
    if base in (int, float):
        return ("a whole number" if base is int else "a number") + _range(meta)
    if base is str:
        return "a string that is not empty" if meta is not None and meta.min_length else "a string"
    if _is_struct(base):
        return "a table with the keys " + ", ".join(field.encode_name for field in msgspec.structs.fields(base))
    origin, arguments = get_origin(base), get_args(base)
    if origin is Literal:
        return ", ".join("false" if value is False else str(value) for value in arguments)
    if origin is dict:
        return "a table"
    if origin is tuple and arguments[-1] is not Ellipsis:
        return "[" + ", ".join(described(argument) for argument in arguments) + "]"
    if origin in (list, tuple):
        filled = " that is not empty" if meta is not None and meta.min_length else ""
        return f"a list{filled}, each item {described(arguments[0])}"
    return "any value"


def _range(meta: Meta | None) -> str:
    if meta is None:
        return ""
    low, high = meta.ge, meta.le
    if low is not None and high is not None:
        return f" from {low:g} to {high:g}" if isinstance(low, float) else f" from {low} to {high}"
    parts = [
        f"{word} {bound:g}"
        for word, bound in (("above", meta.gt), ("at least", low), ("below", meta.lt), ("at most", high))
        if bound is not None
    ]
    return " " + " and ".join(parts) if parts else ""


def members(kind: Any) -> tuple[Any, ...]:
    """The members of a union, else ``kind`` alone; notes that are not msgspec's are left out."""
    base, meta = _bare(kind)
    kind = kind if meta is not None else base
    return get_args(kind) if get_origin(kind) in (Union, types.UnionType) else (kind,)


def _bare(kind: Any) -> tuple[Any, Meta | None]:
    """An annotated type without its annotations, and the first msgspec one."""
    if get_origin(kind) is not Annotated:
        return kind, None
    base, *notes = get_args(kind)
    return base, next((note for note in notes if isinstance(note, Meta)), None)


def _is_struct(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, msgspec.Struct)


def _item_types(option: Any, count: int) -> tuple[Any, ...]:
    """The types of ``count`` items of a list or tuple type; none for another type."""
    base, _ = _bare(option)
    origin, arguments = get_origin(base), get_args(base)
    if origin is list or (origin is tuple and arguments[-1] is Ellipsis):
        return (arguments[0],) * count
    return arguments if origin is tuple else ()


def _may_be_infinite(kind: Any) -> bool:
    metas = [_bare(option) for option in members(kind)]
    return any(base is Any or (meta is not None and meta.extra == MAY_BE_INFINITE) for base, meta in metas)
