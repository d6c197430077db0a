"""The same radial bow on every wafer: y += b (rho^2 - 1/2)."""

from __future__ import annotations

from ..generic import GenericIrregularity, same_everywhere

GENERIC = GenericIrregularity(
    name="fixed_bow",
    meaning="the same radial bow on every wafer",
    needs=("places",),
    parts=lambda lot, scale: same_everywhere("fixed_bow", lot, scale, (lot.x**2 + lot.y**2 - 0.5)[:, None]),
)
