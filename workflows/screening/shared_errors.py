"""What the common errors of a run's tester do to the estimates of its devices."""

from __future__ import annotations

import numpy as np

from pipeline.arrays import FloatArray
from pipeline.device.gyro import PHYSICAL
from pipeline.inference.systematic import common_shifts
from reports.devices import Devices

from ..config import RunConfig
from .settings import population, rate_of


def shared_shifts(config: RunConfig, devices: Devices) -> dict[str, FloatArray]:
    """Quantity -> (5, B) shift [its unit] by one sd of each common error; empty without common errors.

    Campaigns declare their own angular gain, which is not stored: their rate biases are left out.
    """
    if config.systematic.built().exact:
        return {}
    gain = float(population(config).angular_gain) if config.source.kind == "population" else None
    physical = np.stack([devices.number(name) for name in PHYSICAL], axis=-1)
    found = common_shifts(physical, devices.number("split_hz"), rate_of(config, gain))
    return {name: values for name, values in found.items() if np.isfinite(values).any()}
