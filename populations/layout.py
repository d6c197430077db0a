"""The lot, wafer and die of each device number.

    batch = n // (W D),   slot = n mod W,   rank = (n mod W D) // W        W wafers a batch, D dies a wafer
    lot = batch L + slot mod L,             wafer = batch W + slot         L lots a batch

Device numbers alternate between the wafers of a batch and take the dies of a wafer in a fixed low-discrepancy order, so that the
first few hundred devices sample every wafer of the batch over its whole area.  Nothing here is random.

Shapes: B devices, D dies per wafer.  Lengths in mm.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from pipeline.arrays import FloatArray, IntArray
from pipeline.errors import ConfigError

from .nominal import Wafer

PLASTIC = 1.324717957244746  # root of p^3 = p + 1; (1/p, 1/p^2) generate the R2 low-discrepancy sequence


@dataclass(frozen=True, eq=False)
class Places:
    """Lot, wafer (numbered through all lots), wafer in its lot, die and its centre on the wafer [mm], each (B,)."""

    lot: IntArray
    wafer: IntArray
    wafer_in_lot: IntArray
    die: IntArray
    x_mm: FloatArray
    y_mm: FloatArray


@lru_cache(maxsize=32)
def die_centres(wafer: Wafer) -> FloatArray:
    """Centres (D, 2) [mm] of the dies: |(x, y)| <= diameter/2 - edge exclusion, on a grid centred on a die.

    Raises
    ------
    ConfigError : the wafer has no die, or more than 100000.
    """
    reach = wafer.diameter_mm / 2.0 - wafer.edge_exclusion_mm
    if reach < 0.0 or reach / wafer.pitch_mm > 200.0:
        raise ConfigError(
            "wafer.edge_exclusion_mm and wafer.pitch_mm leave no die or more than 100000 dies",
            value=(wafer.edge_exclusion_mm, wafer.pitch_mm),
            allowed=f"edge exclusion up to {wafer.diameter_mm / 2.0:g} mm, pitch from {max(reach, 0.0) / 200.0:g} mm",
            next_step="change [wafer] of the population",
        )
    n = int(reach // wafer.pitch_mm)
    steps = [(i, j) for j in range(-n, n + 1) for i in range(-n, n + 1)]
    inside = [(i, j) for i, j in steps if math.hypot(i, j) * wafer.pitch_mm <= reach]
    centres = wafer.pitch_mm * np.array(inside, dtype=np.float64)
    centres.setflags(write=False)
    return centres


@lru_cache(maxsize=32)
def visiting_order(wafer: Wafer) -> IntArray:
    """Eight orders of the dies, permutations (8, D) [die numbers]: the images of one under the symmetries of the square grid.

    In the first, each point of the R2 sequence, mapped to the disc, takes the nearest die that is still free.
    """
    centres = die_centres(wafer)
    radius = float(np.hypot(centres[:, 0], centres[:, 1]).max()) + wafer.pitch_mm / 2.0
    free = list(range(len(centres)))
    order = []
    for k in range(len(centres)):
        r = radius * math.sqrt((0.5 + k / PLASTIC) % 1.0)
        angle = 2.0 * math.pi * ((0.5 + k / PLASTIC**2) % 1.0)
        x, y = r * math.cos(angle), r * math.sin(angle)
        nearest = min(free, key=lambda die: (round(math.hypot(centres[die, 0] - x, centres[die, 1] - y), 9), die))
        free.remove(nearest)
        order.append(nearest)
    steps = [(round(x), round(y)) for x, y in (centres / wafer.pitch_mm).tolist()]
    number = {step: die for die, step in enumerate(steps)}
    images = [
        [number[sx * steps[die][swap], sy * steps[die][1 - swap]] for die in order]
        for swap in (0, 1)
        for sx, sy in ((1, 1), (-1, -1), (1, -1), (-1, 1))
    ]
    permutations = np.array(images, dtype=np.int64)
    permutations.setflags(write=False)
    return permutations


def places(wafer: Wafer, index: IntArray) -> Places:
    """Lot, wafer and die [numbers from 0] of the devices ``index`` (B,), and the centre of each die [mm]."""
    centres, order = die_centres(wafer), visiting_order(wafer)
    dies, lots = len(centres), wafer.lots_per_batch
    wafers = lots * wafer.wafers_per_lot
    batch, within = np.divmod(index, wafers * dies)
    rank, slot = np.divmod(within, wafers)
    # Each wafer uses another image, so that a few devices do not have the same place on all wafers.
    die = order[slot % len(order), rank]
    return Places(
        lot=batch * lots + slot % lots,
        wafer=batch * wafers + slot,
        wafer_in_lot=slot // lots,
        die=die,
        x_mm=np.take(centres[:, 0], die),
        y_mm=np.take(centres[:, 1], die),
    )
