"""[columns] of campaign.toml: which column of the files is which channel, and its unit, gain and offset.

    drive1_V = "V1"                                     by name, with or without the unit that the file states
    sense1_V = 3                                        by number, counted from 1
    sense1_V = { name = "a", unit = "mV" }              unit of the file; without it, the one that the file states
    sense1_V = { number = 2, gain = 20.0, offset = 0.1 }      value = gain * (column in SI units) - offset
    sense1_V = { number = 2, file = 2 }                 the second file of a [[record]] with file = ["..", ".."]

The value of a channel is in volts, or in the SI unit of its column where that is no voltage (m/s^2, N, m, ..), or in counts.

Shapes: N samples.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

from msgspec import Meta, Struct
from numpy.typing import NDArray

from ...errors import ConfigError, MeasurementError
from ...toml_keys import Meaning
from .units import UNITS, known_unit, split_unit

NAME = re.compile(r"(drive|sense)([1-9][0-9]*)_V")
_ALIKE = re.compile(r"(drive|sense|time)\D*(\d*)", re.IGNORECASE)
_Finite = Annotated[float, Meta(ge=-1e12, le=1e12)]


class ColumnTable(Struct, frozen=True, forbid_unknown_fields=True):
    """The column of a channel: its ``name`` or ``number`` in ``file``; unit of the file, gain, and offset after the gain."""

    name: Annotated[str | None, Meaning("name of the column in the file; or state number")] = None
    number: Annotated[
        Annotated[int, Meta(ge=1)] | None, Meaning("number of the column in the file, from 1; or state name", "1")
    ] = None
    file: Annotated[int, Meta(ge=1), Meaning("which of the files of a record, from 1", "1")] = 1
    unit: Annotated[
        str | None, Meaning("unit of the column in the file; absent: the one that the file states, else V, for time s")
    ] = None
    gain: Annotated[_Finite, Meaning("factor on the column, which turns its unit into volts", "V per unit")] = 1.0
    offset: Annotated[_Finite, Meaning("subtracted after the gain", "V")] = 0.0


#: Name, number or table.
Source = str | Annotated[int, Meta(ge=1)] | ColumnTable


@dataclass(frozen=True)
class Channel:
    """A column of a record: its values (N,) as in the file, value = factor * column - offset, and the ``unit`` of the value."""

    values: NDArray[Any]
    factor: float = 1.0
    offset: float = 0.0
    unit: str = "V"


def channels_of(
    name: str, files: Sequence[Mapping[str, NDArray[Any]]], mapping: Mapping[str, Source]
) -> dict[str, Channel]:
    """Channels ``time_s``, ``drive<k>_V``, ``sense<k>_V`` from the columns of the ``files`` of a record.

    Parameters
    ----------
    name : of the record, for messages.
    files : name -> column (N,) of each file.
    mapping : channel -> its column.  Channels that are not mapped are the columns of these names.

    Raises
    ------
    MeasurementError : no such column, or a column that resembles a channel.
    ConfigError : an unknown unit, or a gain of 0.
    """
    found: dict[str, Channel] = {}
    taken: set[tuple[int, str]] = set()
    for channel, source in mapping.items():
        table = _table(channel, source)
        file, key = column_of(name, channel, table, files, isinstance(source, str))
        taken.add((file, key))
        found[channel] = _scaled(channel, table, key, files[file][key])
    rest = [
        (key, values) for f, columns in enumerate(files) for key, values in columns.items() if (f, key) not in taken
    ]
    for key, values in rest:
        if (key == "time_s" or NAME.fullmatch(key)) and key not in found:
            found[key] = Channel(values, unit="s" if key == "time_s" else "V")
    for key, _ in rest:
        if key not in found:
            _no_lookalike(name, key, found)
    return found


def _table(channel: str, source: Source) -> ColumnTable:
    if channel != "time_s" and not NAME.fullmatch(channel):
        raise MeasurementError(
            "[columns] has a key that is not a column of a record",
            value=channel,
            allowed="time_s, drive<k>_V, sense<k>_V",
            next_step='write, for example, drive1_V = "V1" (the name in the file on the right)',
        )
    return as_table(channel, source)


def as_table(channel: str, source: Source) -> ColumnTable:
    """The table of a source; ConfigError unless it states either a name or a number."""
    if isinstance(source, ColumnTable):
        if (source.name is None) == (source.number is None):
            raise ConfigError(
                f"[columns] {channel} must state either the name or the number of a column",
                value={"name": source.name, "number": source.number},
                allowed='name = ".." or number = 1, 2, ..',
                next_step="correct [columns] in campaign.toml",
            )
        return source
    return ColumnTable(name=source) if isinstance(source, str) else ColumnTable(number=source)


def column_of(
    name: str, channel: str, table: ColumnTable, files: Sequence[Mapping[str, NDArray[Any]]], any_file: bool
) -> tuple[int, str]:
    """File (counted from 0) and name there of the column that ``table`` describes."""
    if table.file > len(files):
        raise ConfigError(
            f"[columns] {channel} is in a file that {name} does not have",
            value=table.file,
            allowed=f"1 to {len(files)}",
            next_step='list all files of the record: file = ["..", ".."]',
        )
    if table.number is not None:
        keys = list(files[table.file - 1])
        if table.number > len(keys):
            raise MeasurementError(
                f"{name}: no column number {table.number}, to which [columns] maps {channel}",
                value=keys[:12],
                allowed=f"1 to {len(keys)}",
                next_step="correct [columns] in campaign.toml",
            )
        return table.file - 1, keys[table.number - 1]
    wanted = table.name or ""
    places = [(f, key) for f, columns in enumerate(files) if any_file or f == table.file - 1 for key in columns]
    exact = [place for place in places if place[1] == wanted] or [p for p in places if split_unit(p[1])[0] == wanted]
    if len(exact) == 1:
        return exact[0]
    if exact:
        raise ConfigError(
            f"{name}: [columns] maps {channel} to {wanted!r}, which occurs {len(exact)} times in its files",
            value=[f"{key} in file {file + 1}" for file, key in exact],
            allowed="one column",
            next_step=f'write {channel} = {{ name = "{exact[0][1]}", file = 1 }}',
        )
    names = [key for _, key in places]
    near = difflib.get_close_matches(wanted, names, n=1)
    raise MeasurementError(
        f"{name}: no column {wanted!r}, to which [columns] maps {channel}",
        value=sorted(names)[:12],
        allowed="the name of a column in the file",
        next_step=f"did you mean {near[0]!r}" if near else "correct [columns] in campaign.toml",
    )


def _scaled(channel: str, table: ColumnTable, key: str, values: NDArray[Any]) -> Channel:
    unit = split_unit(key)[1] if table.unit is None else known_unit(table.unit)
    if table.unit is not None and unit is None:
        near = difflib.get_close_matches(table.unit, UNITS, n=1)
        raise ConfigError(
            f"[columns] {channel} has an unknown unit",
            value=table.unit,
            allowed="V, mV, uV, g, m/s^2, N, m, counts, ..",
            next_step=f"did you mean {near[0]!r}" if near else "state another unit and a gain",
        )
    if table.gain == 0.0:
        raise ConfigError(
            f"[columns] {channel} has a gain of 0", allowed="any other number", next_step="correct gain, or remove it"
        )
    si, factor = UNITS[unit] if unit is not None else ("s" if channel == "time_s" else "V", 1.0)
    if (channel == "time_s") != (si == "s"):
        raise ConfigError(
            f"[columns] {channel} is mapped to a column in {unit}",
            value=key,
            allowed="a time for time_s, a quantity that was measured or commanded for drives and senses",
            next_step="map another column, or state its unit",
        )
    # A gain turns the unit of the file into volts.
    return Channel(values, factor * table.gain, table.offset, "V" if table.gain != 1.0 and channel != "time_s" else si)


def _no_lookalike(name: str, key: str, found: Mapping[str, Channel]) -> None:
    """Reject a misspelt channel name, whose column would otherwise be ignored."""
    if not (alike := _ALIKE.match(key)):
        return
    kind = alike[1].lower()
    meant = "time_s" if kind == "time" else f"{kind}{int(alike[2] or 1) or 1}_V"
    if meant in found:
        return
    raise MeasurementError(
        f"{name}: a column resembles a channel, but its name is not that of one",
        value=key,
        allowed="time_s [s], drive<k>_V [V], sense<k>_V [V]",
        next_step=f"rename it to {meant}, or map it under [columns]; if it is not a channel, give it another name",
    )
