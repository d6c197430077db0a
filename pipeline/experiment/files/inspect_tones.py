"""Recognize sweeps and frequency responses among foreign files; a guess, never a fact.

    frequency   its name or its unit, else a column that goes up and down in equal steps beside one that rises (time)
    sense       X and Y, or R and a phase, by name; without names the two columns that vary the most smoothly with frequency
    drive       its name, else a column of few values (the levels)
    response    columns H_s<j>d<k>_.. of a reader (UFF58, Touchstone), or a real and an imaginary part beside a frequency

Shapes: N rows.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...arrays import FloatArray
from ..tones import ToneKind
from .units import UNITS, split_unit

Columns = Mapping[str, NDArray[Any]]

_FREQUENCY = re.compile(r"(f|freq\w*|frequency\w*|drive_?freq\w*|oscillator|hz)\W*$", re.IGNORECASE)
PARTS: tuple[tuple[str, re.Pattern[str]], ...] = (
    ("X_V", re.compile(r"(.*[._ ])?(x|in_?phase|re|real)\W*\d*$", re.IGNORECASE)),
    ("Y_V", re.compile(r"(.*[._ ])?(y|quadrature|quad|im|imag\w*)\W*\d*$", re.IGNORECASE)),
    ("R_V", re.compile(r"(.*[._ ])?(r|mag\w*|ampl\w*|abs\w*)\W*\d*$", re.IGNORECASE)),
    ("phase_deg", re.compile(r"(.*[._ ])?(phase|phi|theta|arg)\W*\d*$", re.IGNORECASE)),
)
_DRIVE = re.compile(r"(drive|level|excit\w*|osc\w*|u|v_?in|input|amplitude_?in|source)[\W_]*\d*(_V)?$", re.IGNORECASE)
TIME = re.compile(r"(time\w*|t|timestamp|seconds|sec)\W*$", re.IGNORECASE)
_RESPONSE = re.compile(r"H_s[1-9][0-9]*d[1-9][0-9]*_(re|im|abs|dB|phase_deg)")
#: Spread of the steps of a frequency column around their median, and the share of the steps that must lie within.
_EVEN, _MOST = 0.25, 0.85
_FEWEST = 12


@dataclass(frozen=True)
class ToneColumn:
    """A column of a sweep or a frequency response: its key in [columns], name and number in the file, unit, and why."""

    key: str
    name: str
    number: int
    unit: str | None
    why: str
    low: float
    high: float
    named: bool


@dataclass(frozen=True)
class ToneInspection:
    """What files of sweeps or frequency responses seem to hold.

    Parameters
    ----------
    kind : "sweep" or "frf".
    columns : of the first file; the others have the same.
    passes : for each file (row, direction, level) where each pass begins.
    rows : of each file.
    """

    kind: ToneKind
    columns: tuple[ToneColumn, ...]
    passes: tuple[tuple[tuple[int, str, float], ...], ...]
    rows: tuple[int, ...]


def inspect_tones(files: Sequence[tuple[str, Columns]]) -> ToneInspection | None:
    """What ``files``, each a name and its columns (N,), hold as sweeps or frequency responses; ``None`` where neither."""
    first = files[0][1]
    found = _columns(first)
    if found is None or any(list(columns) != list(first) for _, columns in files[1:]):
        return None
    kind, columns = found
    passes = tuple(_passes(each, columns) for _, each in files)
    return ToneInspection(kind, columns, passes, tuple(len(next(iter(each.values()))) for _, each in files))


def _columns(columns: Columns) -> tuple[ToneKind, tuple[ToneColumn, ...]] | None:
    numbers = numbers_of(columns)
    place = {name: k for k, name in enumerate(columns, 1)}

    def made(key: str, name: str, why: str) -> ToneColumn:
        values = numbers[name]
        named = re.fullmatch(r"column\d+", name) is None
        unit = split_unit(name)[1]
        return ToneColumn(key, name, place[name], unit, why, float(values.min()), float(values.max()), named)

    frequency = next((n for n in numbers if is_frequency(n)), None)
    if frequency is not None and any(_RESPONSE.fullmatch(n) for n in numbers):
        own = [made(n, n, "its name") for n in numbers if n.startswith("H_s")]
        return "frf", (made("frequency_hz", frequency, "its name"), *own)
    time = next((n for n in numbers if n != frequency and TIME.match(split_unit(n)[0])), None)
    if frequency is None:
        time = time or next((n for n in numbers if np.all(np.diff(numbers[n]) > 0.0)), None)
        frequency = next((n for n in numbers if n != time and _steps_back_and_forth(numbers[n])), None)
        if frequency is None:
            return None
        return _by_values(numbers, time, frequency, made)
    parts = {
        key: n
        for n in numbers
        for key, pattern in PARTS
        if n not in (time, frequency) and pattern.match(split_unit(n)[0])
    }
    pair = next((p for p in (("X_V", "Y_V"), ("R_V", "phase_deg")) if set(p) <= set(parts)), None)
    if pair is None:
        f = numbers[frequency]
        if not (_steps_back_and_forth(f) or (f[0] > 0.0 and abs(np.sum(np.sign(np.diff(f)))) == f.size - 1)):
            return None
        return _by_values(numbers, time, frequency, made)
    drive = next(
        (n for n in numbers if n not in (time, frequency, *parts.values()) and _DRIVE.match(split_unit(n)[0])), None
    )
    turned = drive is None and not _steps_back_and_forth(numbers[frequency]) and time is None
    kind: ToneKind = "frf" if turned else "sweep"
    stems = {"X_V": "re", "Y_V": "im", "R_V": "abs", "phase_deg": "phase_deg"}
    senses = [made(f"H_s1d1_{stems[p]}" if turned else f"sense1_{p}", parts[p], "its name") for p in pair]
    head = [made("frequency_hz", frequency, "its name")]
    if not turned:
        head += [made("time_s", time, "its name")] if time is not None else []
        head += [made("drive1_V", drive, "its name")] if drive is not None else []
    return kind, (*head, *senses)


def numbers_of(columns: Columns) -> dict[str, FloatArray]:
    """The columns (N,) of numbers of full length, all finite."""
    rows = max((values.size for values in columns.values()), default=0)
    return {
        name: np.asarray(values, dtype=np.float64)
        for name, values in columns.items()
        if values.shape == (rows,) and values.dtype.kind in "fiu" and rows >= _FEWEST and np.all(np.isfinite(values))
    }


def _by_values(
    numbers: Mapping[str, FloatArray], time: str | None, frequency: str, made: Any
) -> tuple[ToneKind, tuple[ToneColumn, ...]] | None:
    """X and Y are the first two columns that vary, the drive one of few values."""
    others = [n for n in numbers if n not in (time, frequency)]
    levels = [n for n in others if np.unique(numbers[n]).size <= max(numbers[n].size // 8, 1)]
    varying = [n for n in others if n not in levels]
    if len(varying) < 2:
        return None
    head = [made("frequency_hz", frequency, "goes through a range in equal steps")]
    head += [made("time_s", time, "rises")] if time is not None else []
    head += [made("drive1_V", levels[0], "has few values: the levels of the drive")] if levels else []
    senses = [made(f"sense1_{p}_V", n, "varies: a guess") for p, n in zip("XY", varying)]
    return "sweep", (*head, *senses)


def is_frequency(name: str) -> bool:
    """Whether the name or the unit of a column says that it is a frequency."""
    base, unit = split_unit(name)
    return bool(_FREQUENCY.match(base)) or (unit is not None and UNITS[unit][0] == "Hz")


def _steps_back_and_forth(values: FloatArray) -> bool:
    """Whether positive values go up and down in equal steps."""
    steps = np.diff(values)
    sizes = np.abs(steps[steps != 0.0])
    if sizes.size < _FEWEST // 2 or values.min() <= 0.0:
        return False
    middle = float(np.median(sizes))
    even = np.mean(np.abs(sizes - middle) < _EVEN * middle)
    turns = np.count_nonzero(np.diff(np.sign(steps[steps != 0.0])))
    return bool(even > _MOST and 0 < turns < values.size // 6)


def _passes(columns: Columns, found: Sequence[ToneColumn]) -> tuple[tuple[int, str, float], ...]:
    """(first row, direction, level) of each pass."""
    names = {column.key: column.name for column in found}
    f = np.asarray(columns[names["frequency_hz"]], dtype=np.float64)
    level = np.asarray(columns[names["drive1_V"]], dtype=np.float64) if "drive1_V" in names else np.ones(f.size)
    direction = np.sign(np.diff(f))
    starts = [0]
    for i in range(1, f.size):
        if level[i] != level[i - 1] or (i - starts[-1] > 1 and direction[i - 1] != direction[i - 2]):
            starts.append(i)
    ends = [*starts[1:], f.size]
    return tuple((a, "up" if f[b - 1] > f[a] else "down", float(level[a])) for a, b in zip(starts, ends) if b - a > 1)
