"""A drift over time, or over the wafers in the order of their names where no time is known: y += b t, t from -1 to 1."""

from __future__ import annotations

import numpy as np

from pipeline.arrays import FloatArray

from ..generic import GenericIrregularity, same_everywhere
from ..measured import MeasuredLot


def along(lot: MeasuredLot) -> FloatArray:
    """(n, 1) time, or number of the wafer, from -1 to 1."""
    known = bool(np.all(np.isfinite(lot.time)) and np.ptp(lot.time) > 0.0)
    t = lot.time if known else lot.codes("wafer").astype(np.float64)
    return np.asarray(2.0 * (t - t.min()) / max(float(np.ptp(t)), 1e-300) - 1.0)[:, None]


GENERIC = GenericIrregularity(
    name="drift",
    meaning="one quantity drifts over time, or over the wafers in their order",
    needs=(),
    parts=lambda lot, scale: same_everywhere("drift", lot, scale, along(lot)) if np.ptp(along(lot)) > 0.0 else (),
)
