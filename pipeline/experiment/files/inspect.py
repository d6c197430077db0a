"""Look at the columns of foreign files: which is time, drive or sense, in which unit, and why; a guess, never a fact.

    time      its name, or values that rise uniformly in the first column
    drive     its name ("drive", "input", "force", "u", ..), else the first column that varies, and others that it does not move
    sense     its name ("sense", "output", "acc", "y", ..), else the columns that are left

A campaign reads all of its files in the same way, so the file in which the most columns vary decides.

Shapes: N samples.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ...errors import MeasurementError
from .causes import further_drives
from .clock import clock_of, pieces
from .mapping import NAME
from .stated_rate import stated_rate
from .units import UNITS, split_unit

Use = Literal["time", "drive", "sense", "unused", "open"]

_TIME = re.compile(r"(time|zeit|t|x_value|timestamp|seconds|sec)\W*$", re.IGNORECASE)
_DRIVE = re.compile(
    r"(drive|input|in|u|force|torque|excit\w*|stim\w*|cmd|command|source|shaker|hammer|v_?in|motor)[\W_]*\d*$",
    re.IGNORECASE,
)
_SENSE = re.compile(
    r"(sense|output|out|y|acc\w*|a|response|resp|vel\w*|disp\w*|pos\w*|strain|pick\W?off|v_?out|signal|sig)[\W_]*\d*$",
    re.IGNORECASE,
)
#: Why a column was taken for a drive or a sense where its name says so.
NAMED = "its name"
_INDEX = re.compile(r"(n|index|sample|samples|row|#|no\.?|nr)\W*$", re.IGNORECASE)
#: Share of the samples at the start that show whether the device was at rest, and its rms relative to the whole.
_START, _QUIET = 0.005, 0.01


@dataclass(frozen=True)
class FileColumn:
    """A column of a file.

    Parameters
    ----------
    name, number : in the file; numbers are counted from 1.
    unit : that the file states, or "counts" for integers; ``None`` where nothing states it.
    use : what it is taken for, and ``why``.
    low, high : smallest and largest value, in the unit of the file.
    named : whether the file names it.
    """

    name: str
    number: int
    unit: str | None
    use: Use
    why: str
    low: float
    high: float
    named: bool = True


@dataclass(frozen=True)
class Inspection:
    """What the files of a campaign seem to hold.

    Parameters
    ----------
    columns : of the file in which the most of them vary.
    sample_rate_hz : from the time column, else from a number that a file states; ``None`` where there is neither.
    rate_from : what states it, in words.
    samples, gaps : of each file.
    at_rest : for each file whether its senses are quiet at the start; silent: whether no drive varies.
    """

    columns: tuple[FileColumn, ...]
    sample_rate_hz: float | None
    samples: tuple[int, ...]
    gaps: tuple[int, ...]
    at_rest: tuple[bool, ...]
    silent: tuple[bool, ...]
    rate_from: str = ""

    def of(self, use: Use) -> tuple[FileColumn, ...]:
        """The columns that are taken for this."""
        return tuple(column for column in self.columns if column.use == use)


def inspect(files: Sequence[tuple[str, Mapping[str, NDArray[Any]]]]) -> Inspection:
    """What ``files``, each a name and its columns (N,), seem to hold.

    Raises
    ------
    MeasurementError : the files have different columns, or no column of numbers that varies.
    """
    first, found = files[0]
    for name, columns in files[1:]:
        if list(columns) != list(found):
            raise MeasurementError(
                f"{name} has other columns than {first}",
                value=list(columns)[:12],
                allowed=str(list(found)[:12]),
                next_step="make a campaign of files with the same columns; drive and sense in separate files are one record:"
                ' file = ["drive.csv", "sense.csv"] in campaign.toml',
            )
    # A silent record does not show which of its columns is a drive.
    seen = max(
        (_uses(each) for _, each in files), key=lambda columns: sum(column.use != "unused" for column in columns)
    )
    if not any(column.use == "sense" for column in seen):
        raise MeasurementError(
            f"{first}: no column of numbers varies",
            value=list(found)[:12],
            allowed="at least one measured signal",
            next_step="check that the export holds the samples",
        )
    time = next((column for column in seen if column.use == "time"), None)
    drives = [column.name for column in seen if column.use == "drive"]
    senses = [column.name for column in seen if column.use == "sense"]
    rates, gaps, rest, silent = [], [], [], []
    used = [column.name for column in seen if column.use != "unused"]
    for name, each in files:
        sizes = sorted({len(each[key]) for key in used})
        if len(sizes) > 1:
            raise MeasurementError(
                f"{name}: the columns have different numbers of rows",
                value=sizes,
                allowed="as many rows in every column that is used",
                next_step="look at this file alone, or export it again",
            )
        if time is not None:
            stamps = np.asarray(each[time.name], dtype=np.float64) * UNITS[time.unit or "s"][1]
            parts = pieces(name, stamps)
            rates.append(clock_of(name, stamps[parts[0]], None).sample_rate_hz)
            gaps.append(len(parts) - 1)
        else:
            gaps.append(0)
        silent.append(not any(np.ptp(each[key]) > 0.0 for key in drives))
        rest.append(_quiet(np.stack([np.asarray(each[key], dtype=np.float64) for key in senses], axis=1)))
    samples = tuple(len(next(iter(each.values()))) for _, each in files)
    stated = next((one for _, each in files if (one := stated_rate(each)) is not None), None)
    rate_from, rate = (
        ("from the time column", rates[0]) if rates else (f"{stated[0]} states it", stated[1]) if stated else ("", None)
    )
    return Inspection(tuple(seen), rate, samples, tuple(gaps), tuple(rest), tuple(silent), rate_from)


def _uses(found: Mapping[str, NDArray[Any]]) -> list[FileColumn]:
    rows = max((np.asarray(values).size for values in found.values()), default=0)
    columns = [_plain(name, k, np.asarray(values), rows) for k, (name, values) in enumerate(found.items(), 1)]
    if not any(column.use == "time" for column in columns) and columns:
        head = np.asarray(next(iter(found.values())))
        if columns[0].use == "open" and head.dtype.kind == "f" and _rises(head):
            columns[0] = replace(columns[0], use="time", why="the first column rises uniformly")
    open_ = [k for k, column in enumerate(columns) if column.use == "open"]
    drives = any(column.use == "drive" for column in columns)
    senses = any(column.use == "sense" for column in columns)
    if not drives and not senses and len(open_) > 2 and not any(columns[k].named for k in open_):
        signals = np.stack([np.asarray(found[columns[k].name], dtype=np.float64) for k in open_], axis=1)
        for place in further_drives(signals):
            why = "moves other columns, and the first drive does not move it: a guess"
            columns[open_[place]] = replace(columns[open_[place]], use="drive", why=why)
    for place, k in enumerate(open_):
        if columns[k].use != "open":
            continue
        if not drives and place == 0 and (len(open_) > 1 or senses):
            columns[k] = replace(columns[k], use="drive", why="the first column that varies: a guess")
        elif not senses or not columns[k].named:
            columns[k] = replace(columns[k], use="sense", why="not the drive: a guess")
        else:
            columns[k] = replace(columns[k], use="unused", why="neither named like a drive nor like a sense")
    return columns


def _plain(name: str, number: int, values: NDArray[Any], rows: int) -> FileColumn:
    """The use of a column by its name and its values; "open" where they do not tell.  The longest column has ``rows``."""
    base, unit = split_unit(name)
    named = re.fullmatch(r"column\d+", name) is None
    if values.size != rows or not rows:
        why = f"{values.size} rows, another column has {rows}" if rows else "no rows"
        return FileColumn(name, number, unit, "unused", why, float("nan"), float("nan"), named)
    if values.dtype.kind not in "fiub" or values.ndim != 1 or not np.all(np.isfinite(values.astype(float))):
        return FileColumn(name, number, unit, "unused", "not numbers in every row", float("nan"), float("nan"), named)
    low, high = float(values.min()), float(values.max())

    def made(use: Use, why: str, unit: str | None = unit) -> FileColumn:
        return FileColumn(name, number, unit, use, why, low, high, named)

    steps = np.diff(values)
    in_seconds = unit is not None and UNITS[unit][0] == "s"
    if (in_seconds or _TIME.match(base)) and np.all(steps >= 0) and high > low:
        return made("time", "its unit" if in_seconds else "its name", unit or "s")
    if values.dtype.kind in "iu" and values.size > 1 and np.all(steps == 1):
        return made("unused", "counts the rows")
    if _INDEX.match(base) and np.all(steps == (steps[0] if steps.size else 0)):
        return made("unused", "counts the rows")
    if high == low:
        return made("drive" if NAME.fullmatch(name) and name.startswith("drive") else "unused", "constant")
    if unit is None and np.all(values == np.round(values)) and max(abs(low), abs(high)) > 1.5:
        unit = "counts"
    if _DRIVE.match(base):
        return made("drive", NAMED, unit)
    if _SENSE.match(base):
        return made("sense", NAMED, unit)
    return made("open", "", unit)


def _rises(values: NDArray[Any]) -> bool:
    steps = np.diff(values)
    return bool(steps.size > 1 and np.all(steps > 0) and np.ptp(steps) < 0.5 * np.median(steps))


def _quiet(sense: NDArray[Any]) -> bool:
    """Whether the senses (N, S) are quiet in their first samples, relative to the whole record."""
    count = max(int(_START * sense.shape[0]), 8)
    rms = np.sqrt(np.mean((sense - sense.mean(axis=0)) ** 2, axis=0))
    start = np.sqrt(np.mean((sense[:count] - sense[:count].mean(axis=0)) ** 2, axis=0))
    return bool(np.all(start <= _QUIET * rms))
