"""A gradient across each wafer, in another direction on each: y += s (n1 x + n2 y), x and y in wafer radii."""

from __future__ import annotations

import numpy as np

from ..generic import GenericIrregularity, by_quantity

GENERIC = GenericIrregularity(
    name="gradient",
    meaning="a gradient across each wafer, in another direction on each",
    needs=("places",),
    parts=lambda lot, scale: by_quantity("gradient", "wafer", lot, scale, np.stack([lot.x, lot.y], axis=-1)),
)
