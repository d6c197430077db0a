"""Assemble a record from the columns of a file, and check them.

    time_s [s]    drive<k>_V [V]    sense<k>_V [V]    k = 1, 2, ...

Time must be uniform, t[n] = t[0] + n / f_s.  All columns must hold finite numbers and have the same length.

Shapes: N samples, D drives, S senses.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...arrays import FloatArray
from ...errors import MeasurementError
from ..record import Clock, Record

#: Relative disagreement allowed between the time column and the declared sample rate.
RATE_TOLERANCE = 1e-4
#: Largest distance of a time stamp from the uniform grid that counts as rounding, in samples.
JITTER_TOLERANCE = 0.05
#: Fewest samples of a record.
MIN_SAMPLES = 16
#: Volts and seconds; even the counts of a 40-bit converter are fewer.  Squares of squares stay far from overflow.
LARGEST = 1e12

_NAME = re.compile(r"(drive|sense)([1-9][0-9]*)_V")
_ALIKE = re.compile(r"(drive|sense|time)\D*(\d*)", re.IGNORECASE)


def _renamed(name: str, found: Mapping[str, NDArray[Any]], mapping: Mapping[str, str]) -> dict[str, NDArray[Any]]:
    """Columns under the names of this project; a column that is mapped loses the name it has in the file."""
    for record_name, file_name in mapping.items():
        if record_name != "time_s" and not _NAME.fullmatch(record_name):
            raise MeasurementError(
                "[columns] has a key that is not a column of a record",
                value=record_name,
                allowed="time_s, drive<k>_V, sense<k>_V",
                next_step='write, for example, drive1_V = "V1" (the name in the file on the right)',
            )
        if file_name not in found:
            near = difflib.get_close_matches(file_name, found, n=1)
            raise MeasurementError(
                f"{name}: no column {file_name!r}, to which [columns] maps {record_name}",
                value=sorted(found)[:12],
                allowed="the name of a column in the file",
                next_step=f"did you mean {near[0]!r}" if near else "correct [columns] in campaign.toml",
            )
    mapped = set(mapping.values())
    columns = {key: values for key, values in found.items() if key not in mapped}
    columns.update({record_name: found[file_name] for record_name, file_name in mapping.items()})
    return columns


def _numbered(name: str, columns: Mapping[str, NDArray[Any]], kind: str) -> list[str]:
    """Names ``kind1_V``, ``kind2_V``, ... of the columns of one kind, checked to have no gap."""
    numbers = sorted(int(m[2]) for key in columns if (m := _NAME.fullmatch(key)) and m[1] == kind)
    wanted = f"{kind}{next(k for k in range(1, len(numbers) + 2) if k not in numbers)}_V"
    if not numbers or numbers[-1] != len(numbers):
        near = difflib.get_close_matches(
            wanted.lower(), [key.lower() for key in columns if key != "time_s"], n=1, cutoff=0.5
        )
        meant = next((key for key in columns if near and key.lower() == near[0]), None)
        usable = meant if meant is not None and not _NAME.fullmatch(meant) else None
        advice = f"rename {usable!r}, or map it" if usable else "map a column"
        source = usable or "<column of the file>"
        raise MeasurementError(
            f"{name}: no column {wanted}",
            value=sorted(columns)[:12],
            allowed="time_s, drive1_V, drive2_V, .., sense1_V, sense2_V, ..",
            next_step=f'{advice}: [columns] {wanted} = "{source}"',
        )
    return [f"{kind}{k}_V" for k in range(1, len(numbers) + 1)]


def _no_lookalikes(name: str, columns: Mapping[str, NDArray[Any]]) -> None:
    """Reject a misspelt channel name, whose column would otherwise be ignored."""
    for key in columns:
        if key == "time_s" or _NAME.fullmatch(key) or not (alike := _ALIKE.match(key)):
            continue
        kind = alike[1].lower()
        meant = "time_s" if kind == "time" else f"{kind}{int(alike[2] or 1) or 1}_V"
        raise MeasurementError(
            f"{name}: a column resembles a channel, but its name is not that of one",
            value=key,
            allowed="time_s [s], drive<k>_V [V], sense<k>_V [V]",
            next_step=f"rename it to {meant}, or map it under [columns]; if it is not a channel, give it another name",
        )


def _numbers(name: str, key: str, values: NDArray[Any]) -> FloatArray:
    if values.dtype.kind not in "fiub" or values.ndim != 1:
        shown = next((v for v in np.ravel(values)[:1000].tolist() if not isinstance(v, (int, float))), values.dtype)
        raise MeasurementError(
            f"{name}: column {key} does not hold numbers",
            value=shown,
            allowed="numbers in every row",
            next_step="correct or remove the rows that contain text",
        )
    numbers = np.array(values, dtype=np.float64)
    bad = np.flatnonzero(~np.isfinite(numbers))
    if bad.size:
        raise MeasurementError(
            f"{name}: column {key} has {bad.size} values that are not finite, the first in row {bad[0]}",
            value=float(numbers[bad[0]]),
            allowed="finite numbers (rows are counted from 0)",
            next_step="cut the record with start and stop in its [[record]], or measure again; missing samples are not filled in",
        )
    large = np.flatnonzero(np.abs(numbers) > LARGEST)
    if large.size:
        raise MeasurementError(
            f"{name}: column {key} has {large.size} values beyond any measurement, the first in row {large[0]}",
            value=float(numbers[large[0]]),
            allowed=f"at most {LARGEST:g} (rows are counted from 0)",
            next_step="check the file format and the unit of the column",
        )
    return numbers


def _clock(name: str, time_s: FloatArray, declared_hz: float | None) -> Clock:
    """Sample rate and jitter of a time column (N,) [s]; raises an error that names the first bad row."""
    steps = np.diff(time_s)
    typical = float(np.median(steps))
    fault, row = "", 0
    if (backward := np.flatnonzero(steps <= 0.0)).size:
        row = int(backward[0]) + 1
        fault = "a time stamp occurs twice" if steps[row - 1] == 0.0 else "time runs backwards"
    elif (gaps := np.flatnonzero(steps > 1.5 * typical)).size:
        row = int(gaps[0]) + 1
        lost = float(np.sum(np.round(steps[gaps] / typical) - 1.0))
        fault = f"{lost:.0f} samples are missing in {gaps.size} gap(s)"
    if fault:
        raise MeasurementError(
            f"{name}: {fault}, first in row {row}",
            value=float(time_s[row]),
            allowed=f"steps of {typical:.6g} s everywhere (rows are counted from 0)",
            next_step=f"cut the record before this row with stop = {row} or after it with start in its [[record]], or measure"
            " again",
        )
    count = time_s.size
    rate = (count - 1) / float(time_s[-1] - time_s[0])
    grid = time_s[0] + np.arange(count) / rate
    away = np.abs(time_s - grid) * rate
    row = int(np.argmax(away))
    if not (np.isfinite(rate) and away[row] <= JITTER_TOLERANCE):
        raise MeasurementError(
            f"{name}: time is not uniform, worst in row {row}",
            value=f"{away[row]:.3g} samples off the uniform grid",
            allowed=f"at most {JITTER_TOLERANCE} samples (rows are counted from 0)",
            next_step="export time_s with more digits, or resample; if the clock is uniform, remove time_s",
        )
    if declared_hz is not None and abs(rate / declared_hz - 1.0) > RATE_TOLERANCE:
        raise MeasurementError(
            f"{name}: the sample rates of the time column and of [instrument] differ",
            value=f"{rate:.9g} Hz in time_s, {declared_hz:.9g} Hz declared",
            allowed=f"a relative difference of at most {RATE_TOLERANCE:g}",
            next_step=f"write sample_rate_hz = {rate:.9g} under [instrument], or remove time_s if it is wrong",
        )
    return Clock(float(f"{rate:.12g}"), float(away[row]))


def assemble(
    name: str,
    found: Mapping[str, NDArray[Any]],
    sample_rate_hz: float | None,
    mapping: Mapping[str, str] | None = None,
) -> Record:
    """A record from the columns of a file.

    Parameters
    ----------
    name : of the file, used in messages and as the name of the record.
    found : name -> column (N,) as read; other columns are ignored unless their names resemble those of channels.
    sample_rate_hz : declared f_s [Hz]; ``None`` takes that of ``time_s``.
    mapping : name of a record column -> name in the file.

    Raises
    ------
    MeasurementError : a column is missing, misspelt, not finite or of another length, or time is not uniform.
    """
    columns = _renamed(name, found, mapping or {})
    drives, senses = _numbered(name, columns, "drive"), _numbered(name, columns, "sense")
    _no_lookalikes(name, columns)
    wanted = [*drives, *senses, *(["time_s"] if "time_s" in columns else [])]
    numbers = {key: _numbers(name, key, columns[key]) for key in wanted}
    lengths = {key: values.size for key, values in numbers.items()}
    if len(set(lengths.values())) != 1 or min(lengths.values()) < MIN_SAMPLES:
        raise MeasurementError(
            f"{name}: the columns differ in length"
            if len(set(lengths.values())) != 1
            else f"{name}: the record is too short",
            value=lengths,
            allowed=f"one length of at least {MIN_SAMPLES} samples",
            next_step="export all columns over the same time span",
        )
    with np.errstate(all="ignore"):  # absurd time stamps may overflow before they are rejected
        clock = _clock(name, numbers["time_s"], sample_rate_hz) if "time_s" in numbers else None
    if clock is None and sample_rate_hz is None:
        raise MeasurementError(
            f"{name}: the sample rate is unknown, because there is no time_s and none is declared",
            value=sorted(columns)[:12],
            allowed="a column time_s, or sample_rate_hz under [instrument] of a campaign.toml",
            next_step="put the file into a folder with a campaign.toml that states sample_rate_hz",
        )
    rate = sample_rate_hz if sample_rate_hz is not None else clock.sample_rate_hz if clock else float("nan")
    return Record(
        name=name,
        sample_rate_hz=rate,
        drive_v=np.stack([numbers[key] for key in drives], axis=1),
        sense_v=np.stack([numbers[key] for key in senses], axis=1),
        clock=clock,
    )
