"""The testers or sites disagree: y += s n(tester)."""

from __future__ import annotations

import numpy as np

from ..generic import GenericIrregularity, by_quantity

GENERIC = GenericIrregularity(
    name="tester_offset",
    meaning="the testers or sites disagree in one quantity",
    needs=("testers",),
    parts=lambda lot, scale: by_quantity("tester_offset", "tester", lot, scale, np.ones((len(lot.device), 1))),
)
