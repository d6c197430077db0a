"""A two-theta pattern, the same on every wafer: y += b1 rho^2 cos 2 phi + b2 rho^2 sin 2 phi."""

from __future__ import annotations

import numpy as np

from ..generic import GenericIrregularity, same_everywhere

GENERIC = GenericIrregularity(
    name="two_theta",
    meaning="a two-theta pattern, the same on every wafer",
    needs=("places",),
    parts=lambda lot, scale: same_everywhere(
        "two_theta", lot, scale, np.stack([lot.x**2 - lot.y**2, 2.0 * lot.x * lot.y], axis=-1)
    ),
)
