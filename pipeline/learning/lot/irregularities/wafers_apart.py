"""Probe: one die position differs on all wafers alike, or a smooth field on each wafer.  Never named."""

from __future__ import annotations

import numpy as np

from pipeline.arrays import FloatArray

from ..generic import GenericIrregularity, by_quantity
from ..measured import MeasuredLot
from ..model import RandomPart

#: Correlation length over the radius of the wafer; between a die and the smooth patterns that have names.
LENGTH = 0.3


def fields(lot: MeasuredLot, scale: FloatArray) -> tuple[RandomPart, ...]:
    """A Gaussian process on each wafer, and a value of each place, for each quantity."""
    found = []
    for k, quantity in enumerate(lot.quantities):
        columns = np.zeros((len(lot.device), len(scale), 1))
        columns[:, k, 0] = scale[k]
        found.append(RandomPart(f"field({quantity})", "wafer", columns, field_mm=LENGTH * lot.radius_mm, start=0.04))
    ones = np.ones((len(lot.device), 1))
    return (*found, *by_quantity("place", "place", lot, scale, ones))


GENERIC = GenericIrregularity(
    name="wafers_apart",
    meaning="neighbours on a wafer are alike beyond the patterns that have names",
    needs=("places",),
    parts=fields,
    probe=True,
)
