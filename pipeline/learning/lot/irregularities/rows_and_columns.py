"""Rows or columns of dies alternate, on every wafer alike: y += b1 (-1)^row + b2 (-1)^column."""

from __future__ import annotations

import numpy as np

from ..generic import GenericIrregularity, same_everywhere
from ..grid import alternating

GENERIC = GenericIrregularity(
    name="rows_and_columns",
    meaning="rows or columns of dies alternate, on every wafer alike",
    needs=("places",),
    parts=lambda lot, scale: same_everywhere("rows_and_columns", lot, scale, np.stack(alternating(lot), axis=-1)),
)
