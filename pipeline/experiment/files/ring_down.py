"""Whether a file shows a free decay: its strongest oscillation falls to little, and no named drive stops or moves it then.

    A(t): modulus of the analytic signal, mean over 4 cycles;   free from 2 cycles behind the last A > 0.95 of its largest

A decay falls below a tenth, to the end of the file, and passes a half and a quarter on its way.

Shapes: N samples.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from ...arrays import FloatArray
from ..decays.backbone import line_hz
from ..decays.pieces import analytic
from ..record import Record
from .causes import moves
from .inspect import NAMED, FileColumn, Inspection

#: Level from which on the motion falls, and below which it has ended; cycles of the mean and of what is left out at the start.
_FULL, _ENDED, _MEAN, _LATER = 0.95, 0.1, 4.0, 2.0
#: A drive, named so, that falls to less than this share of its swing is what stops; then the record is a driven one.
_STOPS = 0.5
#: Shortest decay: share of the file.
_SHORTEST = 0.05


@dataclass(frozen=True)
class RingDown:
    """A free decay in one column: what the file holds in this light, and where it begins [s from the first sample]."""

    found: Inspection
    start_s: float


def ring_down(columns: Mapping[str, NDArray[Any]], found: Inspection) -> RingDown | None:
    """The free decay of a file with ``columns`` (N,), if it shows one that none of its drives explains."""
    rate, senses = found.sample_rate_hz, found.of("sense")
    if rate is None or not senses or found.gaps[0]:
        return None
    swing = {column.name: float(np.std(np.asarray(columns[column.name], dtype=np.float64))) for column in senses}
    best = max(senses, key=lambda column: swing[column.name])
    y = np.asarray(columns[best.name], dtype=np.float64)
    envelope = _envelope(y, rate)
    if envelope is None:
        return None
    amplitude, cycle = envelope
    first = int(np.flatnonzero(amplitude >= _FULL * amplitude.max())[-1])
    tail = amplitude[first:]
    below = [int(np.argmax(tail < level)) for level in amplitude.max() * np.array([0.5, 0.25, _ENDED])]
    ends = float(np.median(amplitude[-max(amplitude.size // 20, 1) :])) < _ENDED * amplitude.max()
    if not ends or not 0 < below[0] < below[1] < below[2] or tail.size < _SHORTEST * y.size:
        return None
    named = [np.asarray(columns[one.name], dtype=np.float64) for one in found.of("drive") if one.why == NAMED]
    # The response to a sweep falls behind a resonance, too.
    if any(_stops(drive, first) or moves(drive[first:], y[first:]) for drive in named):
        return None
    start = 0 if first < cycle * _MEAN else first + int(_LATER * cycle)
    return RingDown(replace(found, columns=tuple(_seen(column, best) for column in found.columns)), start / rate)


def _envelope(y: FloatArray, rate: float) -> tuple[FloatArray, float] | None:
    """A (N,) and the samples of a cycle; ``None`` where there is no line, or it has too few samples or cycles."""
    record = Record("", rate, np.zeros((y.size, 0)), y[:, None])
    f_hz = line_hz(record.sense_v, rate)
    if not 0.0 < f_hz < 0.4 * rate or y.size < 20.0 * rate / f_hz:
        return None
    cycle = rate / f_hz
    return uniform_filter1d(np.abs(analytic(record, f_hz)), max(int(_MEAN * cycle), 1), mode="nearest"), cycle


def _stops(drive: FloatArray, first: int) -> bool:
    """Whether a drive (N,) varies much less behind sample ``first`` than before it."""
    if first < 2 or drive.size - first < 2:
        return False
    return float(np.std(drive[first:])) < _STOPS * float(np.std(drive[:first]))


def _seen(column: FileColumn, best: FileColumn) -> FileColumn:
    if column.use == "drive" and column.why == NAMED:
        return replace(column, use="unused", why="a free decay needs no drive; this one does not stop with the motion")
    if column.use == "drive":
        return replace(
            column,
            use="unused",
            why="a free decay needs no drive, and nothing but its place among the columns makes this one",
        )
    if column.use == "sense" and column is not best:
        return replace(column, use="unused", why="another sense; one alone lets the effects of a resonator be tried")
    return column
