"""Limits of a lot: values in its coordinates to whether a device conforms."""

from __future__ import annotations

import numpy as np

from pipeline.arrays import BoolArray, FloatArray
from pipeline.device.gyro import PHYSICAL
from pipeline.inference.estimate import RateSettings, quantities
from pipeline.learning.lot.forecast import Conforms
from pipeline.learning.lot.gyro import COORDINATES, parameters
from pipeline.learning.lot.table import LotTable
from reports.limits import Limits

#: Demodulation phase error [deg] of the shipped run configuration, for limits of a rate bias.
PHASE_ERROR_DEG = 1.0


def conforms_of(table: LotTable, limits: Limits, angular_gain: float | None) -> Conforms | None:
    """What judges the devices of a lot; ``None`` where it has no limits.

    A gyro is judged by ``limits``, and only where all its coordinates were measured; another table by its own [limits].
    """
    if not table.gyro:
        return table.conforms if table.limits else None
    if table.lot.quantities != COORDINATES:
        return None
    rate = RateSettings(angular_gain, PHASE_ERROR_DEG, "f1")

    def conforms(values: FloatArray) -> BoolArray:
        named = parameters(values)
        physical = np.stack([named[name] for name in PHYSICAL], axis=-1)
        # A coordinate that was not measured, or a drawn damping below zero, conforms to nothing.
        with np.errstate(invalid="ignore", divide="ignore"):
            found = {**quantities(physical, rate, named["split_hz"]), **named}
        keep = np.ones(values.shape[:-1], dtype=np.bool_)
        for limit in limits.limits:
            keep &= limit.admits(np.asarray(found[limit.quantity]))
        return keep

    return conforms
