"""Probe: patterns of third and fourth order over the wafer, on every wafer alike and on each its own.  Never named."""

from __future__ import annotations

import numpy as np

from pipeline.arrays import FloatArray

from ..generic import GenericIrregularity, by_quantity, same_everywhere
from ..measured import MeasuredLot
from ..model import FixedPart, RandomPart


def shapes(lot: MeasuredLot) -> FloatArray:
    """(n, 8) Zernike patterns of order 3 and 4 but for the parts that others cover [1 at the edge]."""
    z = lot.x + 1j * lot.y
    rho2 = np.abs(z) ** 2
    third, fourth = z**3, z**4
    coma, astigmatism = (3.0 * rho2 - 2.0) * z, (4.0 * rho2 - 3.0) * z**2
    parts = [p for one in (third, coma, fourth, astigmatism) for p in (one.real, one.imag)]
    return np.stack(parts, axis=-1)


def both(lot: MeasuredLot, scale: FloatArray) -> tuple[RandomPart | FixedPart, ...]:
    """Fixed and random parts of each quantity."""
    return (
        *same_everywhere("pattern", lot, scale, shapes(lot)),
        *by_quantity("wafer_pattern", "wafer", lot, scale, shapes(lot)),
    )


GENERIC = GenericIrregularity(
    name="higher_patterns",
    meaning="a pattern over the wafer that is none of the others",
    needs=("places",),
    parts=both,
    probe=True,
)
