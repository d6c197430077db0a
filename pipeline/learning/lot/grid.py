"""Rows and columns of the dies of a lot, from their positions."""

from __future__ import annotations

import numpy as np

from ...arrays import FloatArray
from .measured import MeasuredLot


def alternating(lot: MeasuredLot) -> tuple[FloatArray, FloatArray]:
    """+1 and -1 by row and by column of each die, each (n,)."""
    return _signs(lot.y_mm), _signs(lot.x_mm)


def _signs(position: FloatArray) -> FloatArray:
    p = np.nan_to_num(position)
    places = np.unique(np.round(p, 6))
    gaps = np.diff(places)
    # The pitch is the smallest distance between rows that is no rounding.
    real = gaps[gaps > 1e-3 * max(float(np.ptp(p)), 1e-12)]
    pitch = float(real.min()) if real.size else 1.0
    steps = np.round((p - p.min()) / pitch).astype(np.int64)
    return np.where(steps % 2 == 0, 1.0, -1.0)
