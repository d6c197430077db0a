"""Sums of squares of values that belong to nested groups: lots, wafers of a lot, devices of a wafer.

    SS = sum_l n_l (x_l - x)^2 + sum_w n_w (x_w - x_l)^2 + sum_i (x_i - x_w)^2,      df: L - 1, W - L, n - W
    s^2 = SS / (n - 1),      its effective degrees of freedom  nu = SS^2 / sum_k (SS_k^2 / df_k)      (Satterthwaite)
    var(mean) = G/(G - 1) sum_g (n_g (x_g - x))^2 / n^2      over the coarsest groups, G >= 2; s^2/n without groups

Shapes: n values.
Sources: Satterthwaite 1946, Biometrics 2:110; Searle, Casella, McCulloch, Variance Components (1992), ch. 3 (nested sums).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.arrays import FloatArray

from .coded import IntArray


@dataclass(frozen=True)
class Spread:
    """Mean and variances of values in nested groups.

    Parameters
    ----------
    n, mean : number and mean.
    mean_variance, mean_df : variance of the mean, and its degrees of freedom.
    total, total_df : variance s^2 of all values, and its effective degrees of freedom.
    within, within_df : variance within the finest groups; equal to the total without groups.
    groups : number of groups of each level, the coarsest first; levels with one group are left out.
    """

    n: int
    mean: float
    mean_variance: float
    mean_df: float
    total: float
    total_df: float
    within: float
    within_df: float
    groups: tuple[int, ...]


def nested_spread(x: FloatArray, levels: Sequence[IntArray]) -> Spread:
    """Spread of values x (n,), n >= 2, in nested groups.

    Parameters
    ----------
    levels : numbers of the groups (n,) of each level, the coarsest first; a group of a level lies within one of the level before.
    """
    n, mean = x.size, float(np.mean(x))
    centre = np.full(n, mean)
    squares, freedom, groups = [], [], []
    top: FloatArray | None = None
    before = 1
    for codes in levels:
        present, index = np.unique(codes, return_inverse=True)
        if present.size <= before or present.size >= n:
            continue
        size = np.bincount(index).astype(np.float64)
        means = np.bincount(index, weights=x) / size
        squares.append(float(np.sum((means[index] - centre) ** 2)))
        freedom.append(present.size - before)
        top = size * (means - mean) if top is None else top
        centre, before = means[index], present.size
        groups.append(int(present.size))
    squares.append(float(np.sum((x - centre) ** 2)))
    freedom.append(n - before)
    whole = float(sum(squares))
    parts = sum(one**2 / df for one, df in zip(squares, freedom, strict=True))
    total = whole / (n - 1)
    if top is None:
        mean_variance, mean_df = total / n, n - 1.0
    else:
        mean_variance, mean_df = top.size / (top.size - 1.0) * float(np.sum(top**2)) / n**2, top.size - 1.0
    return Spread(
        n,
        mean,
        mean_variance,
        mean_df,
        total,
        whole**2 / parts if parts > 0.0 else n - 1.0,
        squares[-1] / freedom[-1],
        float(freedom[-1]),
        tuple(groups),
    )
