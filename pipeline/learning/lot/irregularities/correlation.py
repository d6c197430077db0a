"""Two quantities vary together from device to device: y_j += s_j n(device), y_k += +-s_k n(device)."""

from __future__ import annotations

import numpy as np

from pipeline.arrays import FloatArray

from ..generic import GenericIrregularity
from ..measured import MeasuredLot
from ..model import RandomPart


def pairs(lot: MeasuredLot, scale: FloatArray) -> tuple[RandomPart, ...]:
    """A part for each pair and sign."""
    found = []
    for j in range(len(scale)):
        for k in range(j):
            for sign, mark in ((1.0, "+"), (-1.0, "-")):
                columns = np.zeros((len(lot.device), len(scale), 1))
                columns[:, j, 0], columns[:, k, 0] = scale[j], sign * scale[k]
                name = f"correlation({lot.quantities[k]}, {mark}{lot.quantities[j]})"
                found.append(RandomPart(name, "device", columns, start=0.04))
    return tuple(found)


GENERIC = GenericIrregularity(
    name="correlation",
    meaning="two quantities vary together from device to device",
    needs=("quantities",),
    parts=pairs,
)
