"""The devices differ in one quantity, independently of all others, by more than the population says: y += s n(device)."""

from __future__ import annotations

import numpy as np

from ..generic import GenericIrregularity, by_quantity

GENERIC = GenericIrregularity(
    name="device_spread",
    meaning="one quantity differs from device to device, independently of the others",
    needs=(),
    parts=lambda lot, scale: by_quantity("device_spread", "device", lot, scale, np.ones((len(lot.device), 1))),
)
