"""The yield of the process when devices of a wafer (or lot) are not independent draws of it.

With G groups of n_g devices and passed x_g,

    var(y) = G/(G-1) sum_g (x_g - y n_g)^2 / n^2                  between-group linearisation
    n*     = y (1 - y)/var(y) (t_{n-1}/t_{G-1})^2                 effective number of devices

and the interval is Clopper-Pearson at n* (Korn and Graubard 1998, Survey Methodology 24:193).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt
from scipy.special import stdtrit

from pipeline.arrays import FloatArray

from .coded import coded, numbered
from .yields import LEVEL, Interval, clopper_pearson


@dataclass(frozen=True)
class Clustering:
    """Spread of the yield between groups of devices.

    Parameters
    ----------
    by : "wafer" or "lot".
    groups : number of groups G.
    between_sd : sd of the groups' true yields, after removal of their binomial scatter.
    design_effect : var(yield) over its binomial value; 1 for independent devices.
    effective : n*, the number of independent devices that would carry the same information.
    interval : of the process yield, groups drawn at random; ``None`` with one group, which contains no
        information about it.
    """

    by: str
    groups: int
    between_sd: float | None
    design_effect: float | None
    effective: float | None
    interval: Interval | None


def clustering(verdicts: Sequence[str], groups: Sequence[str], by: str, level: float = LEVEL) -> Clustering:
    """The yield of the process, with whole groups as independent draws (Korn and Graubard 1998).

    Parameters
    ----------
    verdicts : B verdicts; undecided counts as not passed.
    groups : B names of the group of each device.
    by : kind of group, "wafer" or "lot".
    """
    passed = coded(verdicts).equals("pass").astype(np.float64)
    present, index = numbered(coded(groups).codes)
    g = present.size
    if g < 2:
        return Clustering(by, g, None, None, None, None)
    found = effective_number(passed, index, g)
    if found.design_effect is None:
        # Without scatter between groups only the number of devices determines the interval.
        return Clustering(by, g, 0.0, None, found.effective, clopper_pearson(passed.sum(), found.effective, level))
    interval = clopper_pearson(found.share * found.effective, found.effective, level)
    size = np.bincount(index, minlength=g).astype(np.float64)
    return Clustering(
        by,
        g,
        _between_sd(found.share, size, np.bincount(index, weights=passed, minlength=g).astype(np.float64)),
        found.design_effect,
        found.effective,
        Interval(interval.low, interval.high, f"Korn-Graubard, {by}s as draws", level),
    )


@dataclass(frozen=True)
class EffectiveNumber:
    """Share passed, design effect (``None`` if all or no devices passed), and number of independent devices n*."""

    share: float
    design_effect: float | None
    effective: float


@lru_cache(maxsize=64)
def _student_ratio(n: int, groups: int, level: float) -> float:
    """t_{n-1} / t_{G-1} at the two-sided ``level``."""
    tail = 0.5 * (1.0 + level)
    return float(stdtrit(n - 1.0, tail) / stdtrit(groups - 1.0, tail))


def effective_number(
    passed: FloatArray, index: npt.NDArray[np.int64], groups: int, level: float = LEVEL
) -> EffectiveNumber:
    """n* of Korn and Graubard, with whole groups as draws.

    Parameters
    ----------
    passed : (B,) 1 or 0.
    index : (B,) number of the group of each device.
    groups : number of groups, at least two.
    """
    n, share = float(passed.size), float(passed.mean())
    binomial = share * (1.0 - share) / n
    if binomial == 0.0:
        return EffectiveNumber(share, None, n)
    size = np.bincount(index, minlength=groups).astype(np.float64)
    count = np.bincount(index, weights=passed, minlength=groups)
    variance = groups / (groups - 1.0) * float(np.sum((count - share * size) ** 2)) / n**2
    student = _student_ratio(passed.size, groups, level)
    # With few groups the variance can fall below the binomial one by chance; the binomial variance is the minimum.
    effective = n * min(1.0, binomial / variance if variance > 0.0 else 1.0) * student**2
    return EffectiveNumber(share, variance / binomial, effective)


def _between_sd(share: float, size: FloatArray, count: FloatArray) -> float:
    """Sd of the groups' true yields by analysis of variance; 0 if their scatter is binomial."""
    n, g = float(size.sum()), size.size
    group_share = count / size
    between = float(np.sum(size * (group_share - share) ** 2)) / (g - 1.0)
    if n == g:
        return 0.0
    within = float(np.sum(count * (1.0 - group_share))) / (n - g)
    mean_size = (n - float(np.sum(size**2)) / n) / (g - 1.0)
    return float(np.sqrt(max(0.0, (between - within) / mean_size)))
