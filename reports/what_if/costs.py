"""What limits cost: the yield against each end of a limit, and the devices lost to single limits and to pairs.

Shapes: G positions, W wafers.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.special import stdtrit

from pipeline.arrays import FloatArray

from ..devices import Devices
from ..limits import Limit, Limits
from ..yields import LEVEL, Interval, Yield, clopper_pearson
from .draws import pairs_of
from .judge import Again


@dataclass(frozen=True, eq=False)
class LimitCurve:
    """The yield against one end of a limit, all else as in the new limits.

    Parameters
    ----------
    limit, high : the limit and which end.
    positions, share, low, high_share : (G,) ends, yield, and its 95 % interval.
    old, new : the ends by the old and the new limits; nan where there is none.
    yield_new : yield at ``new``.
    """

    limit: Limit
    high: bool
    positions: FloatArray
    share: FloatArray
    low: FloatArray
    high_share: FloatArray
    old: float
    new: float
    yield_new: float


@dataclass(frozen=True)
class PairLoss:
    """Devices that would pass without two limits and do not pass with them.

    Parameters
    ----------
    first, second : the limits.
    first_alone, second_alone : devices that pass already without this one of the two.
    both : devices that pass only without both.
    share : Clopper-Pearson interval of the sum over all devices.
    """

    first: Limit
    second: Limit
    first_alone: int
    second_alone: int
    both: int
    share: Interval

    @property
    def devices(self) -> int:
        """Devices that pass without the two."""
        return self.first_alone + self.second_alone + self.both


def limit_curves(devices: Devices, again: Again, old: Limits, total: Yield) -> tuple[LimitCurve, ...]:
    wafers = devices.wafers()
    n = len(devices)
    if n == 0:
        return ()
    size = np.bincount(wafers.codes, minlength=max(len(wafers.words), 1)).astype(np.float64)
    out = []
    for grid, passed in zip(again.grids, again.passed, strict=True):
        end = grid.end
        before = [one for one in old.limits if one.quantity == end.limit.quantity]
        intervals = [_interval(row.astype(np.float64), size) for row in passed]
        positions, share = end.position(grid.coordinates), passed.sum(axis=1) / n
        low, high = np.array([one.low for one in intervals]), np.array([one.high for one in intervals])
        order = np.argsort(positions, kind="stable")
        out.append(
            LimitCurve(
                end.limit,
                end.high,
                positions[order],
                share[order],
                low[order],
                high[order],
                (before[0].high if end.high else before[0].low) if before else float("nan"),
                end.value,
                total.value,
            )
        )
    return tuple(out)


def _interval(passed: FloatArray, size: FloatArray) -> Interval:
    """Interval of the yield with ``passed`` (W,) of ``size`` (W,) devices: wafers as draws where there are several."""
    n, count = float(size.sum()), float(passed.sum())
    groups = int(np.sum(size > 0.0))
    if groups < 2 or count in (0.0, n):
        return clopper_pearson(count, n)
    present = size > 0.0
    found = _effective(passed[present], size[present])
    return clopper_pearson(count / n * found, found)


def _effective(passed: FloatArray, size: FloatArray) -> float:
    """Effective number of devices of Korn and Graubard (``reports.clusters``) with ``passed`` (W,) of ``size`` (W,)."""
    n, groups = float(size.sum()), size.size
    share = float(passed.sum()) / n
    variance = groups / (groups - 1.0) * float(np.sum((passed - share * size) ** 2)) / n**2
    binomial = share * (1.0 - share) / n
    student = _student_ratio(n, groups)
    return n * min(1.0, binomial / variance if variance > 0.0 else 1.0) * student**2


@lru_cache(maxsize=64)
def _student_ratio(n: float, groups: int) -> float:
    tail = 0.5 * (1.0 + LEVEL)
    return float(stdtrit(n - 1.0, tail) / stdtrit(groups - 1.0, tail))


def pair_losses(again: Again, new: Limits, devices: int) -> tuple[PairLoss, ...]:
    count = len(new.limits)
    none, alone, two = again.without[0], again.without[1 : 1 + count], again.without[1 + count :]
    out = []
    for k, (i, j) in enumerate(pairs_of(count)):
        first, second, whole = int(alone[i] - none), int(alone[j] - none), int(two[k] - none)
        share = clopper_pearson(whole, devices)
        out.append(PairLoss(new.limits[i], new.limits[j], first, second, whole - first - second, share))
    return tuple(sorted(out, key=lambda row: -row.devices))
