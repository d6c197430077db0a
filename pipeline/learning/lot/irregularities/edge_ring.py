"""The outermost dies differ, on every wafer alike: y += b where rho is in the last tenth of the radius that is used."""

from __future__ import annotations

import numpy as np

from pipeline.arrays import FloatArray

from ..generic import GenericIrregularity, same_everywhere
from ..measured import MeasuredLot

#: Width of the ring over the largest radius of a die.
WIDTH = 0.1


def ring(lot: MeasuredLot) -> FloatArray:
    """(n, 1) one on the ring, zero inside."""
    rho = np.hypot(lot.x, lot.y)
    return np.asarray(rho > (1.0 - WIDTH) * rho.max(), dtype=np.float64)[:, None]


GENERIC = GenericIrregularity(
    name="edge_ring",
    meaning="the outermost dies differ, on every wafer alike",
    needs=("places",),
    parts=lambda lot, scale: same_everywhere("edge_ring", lot, scale, ring(lot)),
)
