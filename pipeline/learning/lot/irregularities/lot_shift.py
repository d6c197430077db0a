"""The lots differ in one quantity by more than the population says: y += s n(lot)."""

from __future__ import annotations

import numpy as np

from ..generic import GenericIrregularity, by_quantity

GENERIC = GenericIrregularity(
    name="lot_shift",
    meaning="one quantity differs from lot to lot",
    needs=("lots",),
    parts=lambda lot, scale: by_quantity("lot_shift", "lot", lot, scale, np.ones((len(lot.device), 1))),
)
