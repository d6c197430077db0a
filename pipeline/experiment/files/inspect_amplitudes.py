"""Recognize the amplitude of a free decay against time among foreign files; a guess, never a fact.

    time         its name; it rises
    amplitude    dBm, dBV or a power by its name or unit; else R, or X and Y, by name.  It falls all the time
    phase        its name, beside R
    frequency    its name; a frequency that is stepped makes the file a sweep

Shapes: N rows.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ...arrays import FloatArray
from .inspect_tones import PARTS, TIME, Columns, is_frequency, numbers_of
from .units import UNITS, split_unit

_LEVEL = re.compile(r"(^|[^a-z])(dBm|dBV)([^a-z]|$)", re.IGNORECASE)
_KEYS = {"dbm": "dBm", "dbv": "dBV"}
#: Rank correlation of amplitude and time in a decay; a peak that is swept through has about 0.
_FALLS = -0.8


@dataclass(frozen=True)
class AmplitudeColumn:
    """A column of an amplitude against time: its key in [columns], name and number in the file, unit, and why."""

    key: str
    name: str
    number: int
    unit: str | None
    why: str


@dataclass(frozen=True)
class AmplitudeInspection:
    """What files of amplitudes seem to hold: the columns of the first, and the rows of each."""

    columns: tuple[AmplitudeColumn, ...]
    rows: tuple[int, ...]

    @property
    def states_frequency(self) -> bool:
        """Whether a column says which mode the files show."""
        return any(column.key == "frequency_hz" for column in self.columns)


def inspect_amplitudes(files: Sequence[tuple[str, Columns]]) -> AmplitudeInspection | None:
    """What ``files``, each a name and its columns (N,), hold as amplitudes of free decays; ``None`` where it is no decay."""
    first = files[0][1]
    if any(list(columns) != list(first) for _, columns in files[1:]):
        return None
    found = _keys(numbers_of(first))
    if not found:
        return None
    place = {name: k for k, name in enumerate(first, 1)}
    columns = tuple(
        AmplitudeColumn(key, name, place[name], split_unit(name)[1], _reason(key)) for key, name in found.items()
    )
    return AmplitudeInspection(columns, tuple(max(values.size for values in each.values()) for _, each in files))


def _keys(numbers: Mapping[str, FloatArray]) -> dict[str, str]:
    """Key -> name of its column; empty where the columns are no amplitude of a decay."""
    time = next((n for n in numbers if TIME.match(split_unit(n)[0]) and np.all(np.diff(numbers[n]) > 0.0)), None)
    if time is None:
        return {}
    frequency = next((n for n in numbers if n != time and is_frequency(n)), None)
    if frequency is not None and _stepped(numbers[frequency]):
        return {}
    others = [n for n in numbers if n not in (time, frequency)]
    parts = {key: n for n in others for key, pattern in PARTS if pattern.match(split_unit(n)[0])}
    level = next(((key, n) for n in others if (key := _level(n)) is not None), None)
    if level is not None:
        own, amplitude = {f"sense1_{level[0]}": level[1]}, numbers[level[1]]
    elif {"X_V", "Y_V"} <= set(parts):
        own = {f"sense1_{key}": parts[key] for key in ("X_V", "Y_V")}
        amplitude = np.hypot(numbers[parts["X_V"]], numbers[parts["Y_V"]])
    elif "R_V" in parts:
        own, amplitude = {"sense1_R_V": parts["R_V"]}, numbers[parts["R_V"]]
    else:
        return {}
    if not _falls(numbers[time], amplitude):
        return {}
    if "phase_deg" in parts and "sense1_X_V" not in own:
        own["sense1_phase_deg"] = parts["phase_deg"]
    return {"time_s": time, **({} if frequency is None else {"frequency_hz": frequency}), **own}


def _level(name: str) -> str | None:
    """Suffix of the key of a level or a power; ``None`` for another column."""
    if (found := _LEVEL.search(name)) is not None:
        return _KEYS[found[2].lower()]
    unit = split_unit(name)[1]
    return "W" if unit is not None and UNITS[unit][0] == "W" else None


def _stepped(frequency_hz: FloatArray) -> bool:
    """Whether a frequency goes through a range: every step has the sign of the first."""
    steps = np.diff(frequency_hz)
    return bool(np.all(steps > 0.0) or np.all(steps < 0.0))


def _falls(time_s: FloatArray, amplitude: FloatArray) -> bool:
    """Whether an amplitude falls with time, by the correlation of ranks (Spearman), before the last twentieth of its fall.

    A record that goes on for long after its decay ends in noise.
    """
    low, high = float(np.median(amplitude[-max(amplitude.size // 20, 1) :])), float(amplitude.max())
    last = int(np.flatnonzero(amplitude > low + 0.05 * (high - low))[-1]) + 1 if high > low else 0
    if last < amplitude.size // 20 or last < 10:
        return False
    ranks = np.argsort(np.argsort(amplitude[:last])).astype(np.float64)
    return float(np.corrcoef(time_s[:last], ranks)[0, 1]) < _FALLS


def _reason(key: str) -> str:
    return "its name; it falls all the time" if key.startswith("sense1") and "phase" not in key else "its name"
