"""A radial bow of another size on each wafer: y += s n (rho^2 - 1/2)."""

from __future__ import annotations

from ..generic import GenericIrregularity, by_quantity

GENERIC = GenericIrregularity(
    name="bow",
    meaning="a radial bow of another size on each wafer",
    needs=("places",),
    parts=lambda lot, scale: by_quantity("bow", "wafer", lot, scale, (lot.x**2 + lot.y**2 - 0.5)[:, None]),
)
