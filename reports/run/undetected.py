"""What undetected effects could still do to the devices that are ok: bounds of their biases against sds and limits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pipeline.quantities import NAMES

from ..devices import Devices
from ..limits import Limits
from ..order_statistics import median, quantiles


@dataclass(frozen=True)
class BiasBound:
    """Bounds of the bias of one quantity over the ok devices.

    Parameters
    ----------
    quantity : its name.
    devices : how many have a bound.
    median, q95 : of bound / sd [1].
    of_limits : median of bound / width of the limits [1]; nan without limits.
    """

    quantity: str
    devices: int
    median: float
    q95: float
    of_limits: float


def bias_bounds(devices: Devices, limits: Limits) -> tuple[BiasBound, ...]:
    """Bounds of all quantities that have one, in the order of the results."""
    return tuple(row for row in (bias_bound(devices, limits, name) for name in NAMES) if row is not None)


def bias_bound(devices: Devices, limits: Limits, name: str) -> BiasBound | None:
    """Bounds of one quantity; ``None`` where no device has one."""
    bound, sd = devices.number(f"{name}_bias_bound"), devices.number(f"{name}_sd")
    known = devices.is_ok() & np.isfinite(bound) & (sd > 0.0)
    if not known.any():
        return None
    bound, sd = bound[known], sd[known]
    width = {limit.quantity: limit.width for limit in limits.limits}.get(name, 0.0)
    middle, q95 = quantiles(bound / sd, (0.5, 0.95)).tolist()
    share = median(bound) / width if width > 0.0 else float("nan")
    return BiasBound(name, bound.size, middle, q95, share)
