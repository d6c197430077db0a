"""Assemble a record from the columns of a file, and check them.

    time_s [s]    drive<k>_V [V]    sense<k>_V [V]    k = 1, 2, ...

Time must be uniform (see ``clock``); a record is divided where samples are missing.  All columns must hold finite numbers and
have the same length.  A record without drive columns was not driven.

Shapes: N samples, D drives, S senses.
"""

from __future__ import annotations

import dataclasses
import difflib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...arrays import FloatArray
from ...errors import MeasurementError
from ..record import Record
from .clock import MIN_SAMPLES, clock_of, pieces
from .mapping import NAME, Channel, Source, channels_of

#: Volts and seconds; even the counts of a 40-bit converter are fewer.  Squares of squares stay far from overflow.
LARGEST = 1e12


def _numbered(name: str, channels: Mapping[str, Channel], in_files: Sequence[str], kind: str) -> list[str]:
    """Names ``kind1_V``, ``kind2_V``, ... of the channels of one kind, checked to have no gap."""
    numbers = sorted(int(m[2]) for key in channels if (m := NAME.fullmatch(key)) and m[1] == kind)
    wanted = f"{kind}{next(k for k in range(1, len(numbers) + 2) if k not in numbers)}_V"
    if (not numbers and kind == "sense") or (numbers and numbers[-1] != len(numbers)):
        others = [key for key in in_files if key != "time_s"]
        near = difflib.get_close_matches(wanted.lower(), [key.lower() for key in others], n=1, cutoff=0.5)
        meant = next((key for key in others if near and key.lower() == near[0]), None)
        usable = meant if meant is not None and not NAME.fullmatch(meant) else None
        advice = f"rename {usable!r}, or map it" if usable else "map a column"
        source = usable or "<column of the file>"
        raise MeasurementError(
            f"{name}: no column {wanted}",
            value=sorted(in_files)[:12],
            allowed="time_s, drive1_V, drive2_V, .., sense1_V, sense2_V, ..",
            next_step=f'{advice}: [columns] {wanted} = "{source}"',
        )
    return [f"{kind}{k}_V" for k in range(1, len(numbers) + 1)]


def _check_numeric(name: str, key: str, values: NDArray[Any]) -> None:
    """Raise MeasurementError unless a column holds numbers, or date and time where it is ``time_s``."""
    if values.ndim == 1 and (values.dtype.kind in "fiub" or (values.dtype.kind == "M" and key == "time_s")):
        return
    shown = next((v for v in np.ravel(values)[:1000].tolist() if not isinstance(v, (int, float))), values.dtype)
    raise MeasurementError(
        f"{name}: column {key} does not hold numbers",
        value=shown,
        allowed="numbers in every row",
        next_step="correct or remove the rows that contain text",
    )


def _numbers(name: str, key: str, channel: Channel, rows: slice) -> FloatArray:
    """The values of the chosen rows, in the unit of the channel."""
    values = channel.values[rows]
    if values.dtype.kind == "M":
        values = (values - values[0]) / np.timedelta64(1, "s")
    numbers = np.require(values, np.float64, ("C", "W"))
    if float(numbers.max(initial=0.0)) <= LARGEST and float(numbers.min(initial=0.0)) >= -LARGEST:
        return numbers if (channel.factor, channel.offset) == (1.0, 0.0) else channel.factor * numbers - channel.offset
    bad = np.flatnonzero(~np.isfinite(numbers))
    if bad.size:
        raise MeasurementError(
            f"{name}: column {key} has {bad.size} values that are not finite, the first in row {rows.start + bad[0]}",
            value=float(numbers[bad[0]]),
            allowed="finite numbers (rows are counted from 0)",
            next_step=f"{_cut(rows.start, bad, numbers.size)}measure again; missing samples are not filled in",
        )
    large = np.flatnonzero(np.abs(numbers) > LARGEST)
    if large.size:
        raise MeasurementError(
            f"{name}: column {key} has {large.size} values beyond any measurement, the first in row {rows.start + large[0]}",
            value=float(numbers[large[0]]),
            allowed=f"at most {LARGEST:g} (rows are counted from 0)",
            next_step="check the file format and the unit of the column",
        )
    return channel.factor * numbers - channel.offset


def _cut(first_row: int, bad: NDArray[Any], count: int) -> str:
    """The longest stretch without the ``bad`` rows (B,), counted from ``first_row``, as an advice; "" where it is too short."""
    edges = np.concatenate([[-1], bad, [count]])
    k = int(np.argmax(np.diff(edges)))
    start, stop = int(edges[k]) + 1, int(edges[k + 1])
    if stop - start < MIN_SAMPLES:
        return ""
    return f"cut the record with start = {first_row + start} and stop = {first_row + stop} in its [[record]], or "


def _side_by_side(columns: Sequence[FloatArray], count: int) -> FloatArray:
    """(N, K) of K columns (N,), N = ``count``; a single one is not copied."""
    if len(columns) == 1:
        return columns[0][:, None]
    return np.stack(columns, axis=1) if columns else np.zeros((count, 0))


def assemble(
    name: str,
    files: Sequence[Mapping[str, NDArray[Any]]],
    sample_rate_hz: float | None,
    mapping: Mapping[str, Source] | None = None,
    start: int = 0,
    stop: int | None = None,
) -> tuple[Record, ...]:
    """A record from the columns of its files, divided where samples are missing.

    Parameters
    ----------
    name : of the record, used in messages; pieces behind a gap get a number.
    files : name -> column (N,) as read, for each file; other columns are ignored unless their names resemble those of channels.
    sample_rate_hz : declared f_s [Hz]; ``None`` takes that of ``time_s``.
    mapping : channel -> its column (see ``mapping``).
    start, stop : the rows start <= n < stop are read.

    Raises
    ------
    MeasurementError : a column is missing, misspelt, not finite or of another length, or time is not uniform.
    ConfigError : ``mapping`` has a wrong entry.
    """
    channels = channels_of(name, files, mapping or {})
    in_files = [key for columns in files for key in columns]
    drives, senses = (_numbered(name, channels, in_files, kind) for kind in ("drive", "sense"))
    wanted = [*drives, *senses, *(["time_s"] if "time_s" in channels else [])]
    for key in wanted:
        _check_numeric(name, key, channels[key].values)
    lengths = {key: channels[key].values.size for key in wanted}
    if len(set(lengths.values())) != 1 or min(lengths.values()) < MIN_SAMPLES:
        raise MeasurementError(
            f"{name}: the columns differ in length"
            if len(set(lengths.values())) != 1
            else f"{name}: the record is too short",
            value=lengths,
            allowed=f"one length of at least {MIN_SAMPLES} samples",
            next_step="export all columns over the same time span",
        )
    rows = _rows(name, min(lengths.values()), start, stop)
    numbers = {key: _numbers(name, key, channels[key], rows) for key in wanted}
    if "time_s" not in numbers and sample_rate_hz is None:
        raise MeasurementError(
            f"{name}: the sample rate is unknown, because there is no time_s and none is declared",
            value=sorted(in_files)[:12],
            allowed="a column time_s, or sample_rate_hz under [instrument] of a campaign.toml",
            next_step="put the file into a folder with a campaign.toml that states sample_rate_hz",
        )
    count = rows.stop - rows.start
    drive_v, sense_v = (_side_by_side([numbers[key] for key in keys], count) for keys in (drives, senses))
    units = {key: channels[key].unit for key in (*drives, *senses) if channels[key].unit != "V"}
    whole = Record(name, sample_rate_hz or float("nan"), drive_v, sense_v, units=units)
    return _divided(whole, numbers.get("time_s"), sample_rate_hz, rows.start)


def _rows(name: str, count: int, start: int, stop: int | None) -> slice:
    end = count if stop is None else stop
    if end > count or end - start < MIN_SAMPLES:
        raise MeasurementError(
            f"{name}: start and stop do not lie within the record",
            value=[start, end],
            allowed=f"0 <= start, start + {MIN_SAMPLES} <= stop <= {count}",
            next_step="correct start and stop of this [[record]]",
        )
    return slice(start, end)


def _divided(
    whole: Record, time_s: FloatArray | None, sample_rate_hz: float | None, first_row: int
) -> tuple[Record, ...]:
    """The uniform pieces of ``whole``, which begins at ``first_row``; pieces shorter than the shortest record are left out."""
    if time_s is None:
        return (dataclasses.replace(whole, elapsed_s=first_row / whole.sample_rate_hz),)
    parts = [part for part in pieces(whole.name, time_s, first_row) if part.stop - part.start >= MIN_SAMPLES]
    if not parts:
        raise MeasurementError(
            f"{whole.name}: no piece between gaps has {MIN_SAMPLES} samples",
            allowed="a uniform time column",
            next_step="resample the record to a uniform time, or measure again",
        )
    records: list[Record] = []
    for k, part in enumerate(parts):
        name = whole.name if k == 0 else f"{whole.name} ({k + 1})"
        with np.errstate(all="ignore"):  # absurd time stamps may overflow before they are rejected
            rate = sample_rate_hz or (records[0].sample_rate_hz if records else None)
            clock = clock_of(name, time_s[part], rate, first_row + part.start)
        records.append(
            dataclasses.replace(
                whole,
                name=name,
                sample_rate_hz=rate or clock.sample_rate_hz,
                drive_v=whole.drive_v[part],
                sense_v=whole.sense_v[part],
                clock=clock,
                at_rest=whole.at_rest and part.start == 0,
                elapsed_s=first_row / (rate or clock.sample_rate_hz) + float(time_s[part.start] - time_s[0]),
            )
        )
    return tuple(records)


def only(records: Sequence[Record]) -> Record:
    """The one piece of a record; MeasurementError where samples are missing."""
    if len(records) > 1:
        first, second = records[:2]
        rows = first.drive_v.shape[0]
        starts = [0.0 if record.clock is None else record.clock.start_s for record in (first, second)]
        lost = round((starts[1] - starts[0]) * first.sample_rate_hz) - rows
        raise MeasurementError(
            f"{first.name}: {lost} samples are missing before row {rows}",
            value=f"{len(records) - 1} gaps",
            allowed="a record without gaps (rows are counted from 0)",
            next_step=f"put it into a campaign, where each piece is a record, or end that [[record]] with stop = {rows}",
        )
    return records[0]
