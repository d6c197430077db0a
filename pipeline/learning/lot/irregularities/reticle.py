"""A pattern that repeats with the exposure field of 2 x 2 dies: y += b (-1)^(row + column)."""

from __future__ import annotations

import numpy as np

from ..generic import GenericIrregularity, same_everywhere
from ..grid import alternating

GENERIC = GenericIrregularity(
    name="reticle",
    meaning="a pattern that repeats with an exposure field of 2 x 2 dies",
    needs=("places",),
    parts=lambda lot, scale: same_everywhere("reticle", lot, scale, np.prod(alternating(lot), axis=0)[:, None]),
)
