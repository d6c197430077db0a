"""Die positions [mm] as places of an integer grid, which wafer maps of other programs need.

    x = x0 + p X,  p the largest pitch of which all differences are multiples, |x0| <= p/2

The smallest difference is a multiple of the pitch, so its whole fractions are tried, the largest first.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pipeline.arrays import FloatArray

from ..coded import IntArray

#: Positions of files are rounded to a micrometre, so that a difference is off by 1 um and, with that of the pitch, by 2 um [mm].
_TOLERANCE_MM = 2.5e-3
#: Smallest pitch that is tried [mm]: no gyro is smaller, and a finer grid would fit any positions.
_LEAST_MM = 0.1
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
        different = np.unique(values[known])
        pitch = _pitch(different)
        place = np.zeros(values.shape, dtype=np.int64)
        if pitch > 0.0:
            offset = different[0] - pitch * np.round(different[0] / pitch)
            place[known] = np.round((values[known] - offset) / pitch)
        if (different.size > 1 and pitch == 0.0) or np.abs(place).max(initial=0) > _MOST:
            known = np.zeros_like(known)
        places.append(place)
        pitches.append(pitch)
    return DieGrid(places[0], places[1], known, (pitches[0], pitches[1]))


def _pitch(values: FloatArray) -> float:
    """The largest pitch of which all differences of the sorted ``values`` [mm] are multiples; 0 where there is none."""
    if values.size < 2:
        return 0.0
    steps = values[1:] - values[0]
    smallest = float(np.diff(values).min())
    for divisor in range(1, int(smallest / _LEAST_MM) + 1):
        pitch = smallest / divisor
        for step in steps.tolist():
            # The longest difference so far gives the pitch with the least rounding.
            pitch = step / round(step / pitch)
        if np.abs(steps - pitch * np.round(steps / pitch)).max() <= _TOLERANCE_MM:
            return float(pitch)
    return 0.0
