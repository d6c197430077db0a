"""The same gradient on every wafer: y += b1 x + b2 y, x and y in wafer radii."""

from __future__ import annotations

import numpy as np

from ..generic import GenericIrregularity, same_everywhere

GENERIC = GenericIrregularity(
    name="fixed_gradient",
    meaning="the same gradient on every wafer",
    needs=("places",),
    parts=lambda lot, scale: same_everywhere("fixed_gradient", lot, scale, np.stack([lot.x, lot.y], axis=-1)),
)
