"""Spread of values that belong to nested groups: lots, wafers of a lot, devices of a wafer.

    MS_1 (between lots), MS_2 (between wafers of a lot), MS_e (within wafers)     mean squares of the nested analysis of variance
    E MS_1 = s_e^2 + k2 s_2^2 + k3 s_1^2,   E MS_2 = s_e^2 + k1 s_2^2,   E MS_e = s_e^2
    sigma^2 = s_1^2 + s_2^2 + s_e^2 = sum_k c_k MS_k          the variance of a device of any lot; s^2 without groups
    nu = sigma^4 / sum_k (c_k MS_k)^2 / df_k                  its effective degrees of freedom (Satterthwaite)
    sigma^2 - sqrt(sum_k (1 - df_k/chi2_up)^2 (c_k MS_k)^2)  to  sigma^2 + sqrt(sum_k (df_k/chi2_low - 1)^2 (c_k MS_k)^2)
                                                              its interval (Graybill and Wang); of chi2 without groups
    var(mean) = G/(G - 1) sum_g (n_g (x_g - x))^2 / n^2       over the coarsest groups, G >= 2; s^2/n without groups

The plain s^2 of few lots is too small: the lots that were not made differ as much.  With the same number of devices in all
groups, k1 = k2 is the number in a wafer and k3 that in a lot.

Shapes: n values.
Sources: Searle, Casella, McCulloch, Variance Components (1992), table F.1 (k1, k2, k3 of unequal groups); Satterthwaite 1946,
Biometrics 2:110; Graybill and Wang 1980, J. Am. Stat. Assoc. 75:869.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from pipeline.arrays import FloatArray

from .coded import IntArray, numbered
from .yields import LEVEL


@dataclass(frozen=True)
class NestedSpread:
    """Mean and variances of values in nested groups.

    Parameters
    ----------
    n, mean : number and mean.
    mean_variance, mean_df : variance of the mean, and its degrees of freedom.
    total, total_df : sigma^2 and its effective degrees of freedom.
    total_interval : of sigma^2.
    within, within_df, within_interval : the same within the finest groups; equal to the total without groups.
    groups : number of groups of each level, the coarsest first; levels that divide nothing are left out.
    """

    n: int
    mean: float
    mean_variance: float
    mean_df: float
    total: float
    total_df: float
    total_interval: tuple[float, float]
    within: float
    within_df: float
    within_interval: tuple[float, float]
    groups: tuple[int, ...]


def nested_spread(x: FloatArray, levels: Sequence[IntArray]) -> NestedSpread:
    """Spread of values x (n,), n >= 2, in at most two nested levels.

    Parameters
    ----------
    levels : numbers (n,) >= 0 of the groups of each level, the coarsest first; a group lies within one of the level before.
    """
    n, mean = x.size, float(np.mean(x))
    kept: list[IntArray] = []
    for codes in levels:
        present, index = numbered(codes)
        if (int(kept[-1].max()) + 1 if kept else 1) < present.size < n:
            kept.append(index)
    centre, before = np.full(n, mean), 1
    squares, freedom = [], []
    for index in kept:
        means = np.bincount(index, weights=x) / np.bincount(index)
        squares.append(float(np.sum((means[index] - centre) ** 2)))
        freedom.append(means.size - before)
        centre, before = means[index], means.size
    squares.append(float(np.sum((x - centre) ** 2)))
    freedom.append(n - before)
    mean_squares = np.array(squares) / np.array(freedom)
    parts = _coefficients(kept, n) * mean_squares
    total = float(parts.sum())
    spread = float(np.sum(parts**2 / np.array(freedom)))
    mean_variance, mean_df = total / n, n - 1.0
    if kept:
        size = np.bincount(kept[0]).astype(np.float64)
        top = np.bincount(kept[0], weights=x) - size * mean
        mean_variance, mean_df = top.size / (top.size - 1.0) * float(np.sum(top**2)) / n**2, top.size - 1.0
    groups = tuple(int(index.max()) + 1 for index in kept)
    return NestedSpread(
        n,
        mean,
        mean_variance,
        mean_df,
        total,
        total**2 / spread if spread > 0.0 else n - 1.0,
        variance_interval(parts, np.array(freedom)),
        float(mean_squares[-1]),
        float(freedom[-1]),
        variance_interval(mean_squares[-1:], np.array(freedom[-1:])),
        groups,
    )


def variance_interval(parts: FloatArray, freedom: IntArray, level: float = LEVEL) -> tuple[float, float]:
    """Interval of a sum of independent variances ``parts`` (K,) with ``freedom`` (K,) degrees of freedom; not below 0."""
    tail = 0.5 * (1.0 - level)
    # chdtri(df, p) has the probability p above it.
    down, up = 1.0 - freedom / chdtri(freedom, tail), freedom / chdtri(freedom, 1.0 - tail) - 1.0
    low = float(parts.sum() - np.sqrt(np.sum((down * parts) ** 2)))
    return max(0.0, low), float(parts.sum() + np.sqrt(np.sum((up * parts) ** 2)))


def _coefficients(levels: Sequence[IntArray], n: int) -> FloatArray:
    """c_k of the mean squares, the coarsest level first and the residual last."""
    if not levels:
        return np.ones(1)
    size = [np.bincount(index).astype(np.float64) for index in levels]
    top = (n - float(np.sum(size[0] ** 2)) / n) / (size[0].size - 1)
    if len(levels) == 1:
        return np.array([1.0 / top, 1.0 - 1.0 / top])
    lot_of = np.zeros(size[1].size, dtype=np.int64)
    lot_of[levels[1]] = levels[0]
    inner = float(np.sum(size[1] ** 2 / size[0][lot_of]))
    k1 = (n - inner) / (size[1].size - size[0].size)
    k2 = (inner - float(np.sum(size[1] ** 2)) / n) / (size[0].size - 1)
    first, second = 1.0 / top, (1.0 - k2 / top) / k1
    return np.array([first, second, 1.0 - first - second])
