"""The wafers of a lot differ in one quantity by more than the population says: y += s n(wafer)."""

from __future__ import annotations

import numpy as np

from ..generic import GenericIrregularity, by_quantity

GENERIC = GenericIrregularity(
    name="wafer_shift",
    meaning="one quantity differs from wafer to wafer",
    needs=("wafers",),
    parts=lambda lot, scale: by_quantity("wafer_shift", "wafer", lot, scale, np.ones((len(lot.device), 1))),
)
