"""Die positions [mm] as places of an integer grid, which wafer maps of other programs need.

    x = x0 + p X,  p the largest pitch of which all differences are multiples, |x0| <= p/2

The pitch is found by Euclid's algorithm on the differences of the positions, with a tolerance for their rounding.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pipeline.arrays import FloatArray

from ..coded import IntArray

#: Rounding of positions in files [mm]; a pitch is not smaller than ten times this.
_TOLERANCE_MM = 1e-3
#: Places of a grid of STDF (I*2, without the mark for none).
_MOST = 32767


@dataclass(frozen=True, eq=False)
class DieGrid:
    """Place (B,) of each die and the pitch [mm] along x and y; ``known`` (B,) where it has one."""

    x: IntArray
    y: IntArray
    known: np.ndarray[tuple[int], np.dtype[np.bool_]]
    pitch_mm: tuple[float, float]


def die_grid(x_mm: FloatArray, y_mm: FloatArray) -> DieGrid:
    """The grid of die centres (B,) from the wafer's centre [mm]; nan is unknown, and so are all dies that lie on no grid."""
    known = np.isfinite(x_mm) & np.isfinite(y_mm)
    places, pitches = [], []
    for values in (x_mm, y_mm):
        pitch = _pitch(np.unique(values[known]))
        place = np.zeros(values.shape)
        if pitch > 0.0:
            first = values[known][0] if known.any() else 0.0
            offset = first - pitch * np.round(first / pitch)
            place[known] = np.round((values[known] - offset) / pitch)
            on_grid = np.abs(values[known] - offset - pitch * place[known]) <= 10 * _TOLERANCE_MM
            if not on_grid.all() or np.abs(place).max() > _MOST:
                known = np.zeros_like(known)
        places.append(place.astype(np.int64))
        pitches.append(pitch)
    return DieGrid(places[0], places[1], known, (pitches[0], pitches[1]))


def _pitch(values: FloatArray) -> float:
    """The largest pitch of which all differences of sorted ``values`` [mm] are multiples; 0 for a single value."""
    found = 0.0
    for step in np.unique(np.round(np.diff(values) / _TOLERANCE_MM)) * _TOLERANCE_MM:
        a, b = max(found, float(step)), min(found, float(step))
        while b > 5 * _TOLERANCE_MM:
            a, b = b, a - b * np.round(a / b)
            b = abs(b)
        found = a
    # Euclid adds up the roundings; the whole range gives the pitch with the least of them.
    steps = np.round((values[-1] - values[0]) / found) if values.size > 1 and found > 0.0 else 0.0
    return float((values[-1] - values[0]) / steps) if steps else 0.0
