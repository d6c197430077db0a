"""How much of the variance of lost verdicts is that of the true loss.

    t: 1 where the true device is lost,  v: 1 where its verdict is not "pass":   r^2 = cov(t, v)^2 / (var t var v)

If the verdict depends on the device through its true loss only, E[v | irregularities] = a + b t, so that the irregularities have
r^2 of the variance of v, in the same shares as that of t, and the measurement has the rest.
sd: delete-one-lot jackknife; interval: Student's t on Fisher's scale atanh(r).

Shapes: N devices.
Source: law of total variance; Fisher, Metron 1 (1921) 3.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.special import stdtrit

from pipeline.arrays import BoolArray, FloatArray, IntArray

from ..coded import numbered
from ..interval_estimate import IntervalEstimate
from ..yields import LEVEL

_NEVER_ONE = 1.0 - 1e-12


def explained_verdicts(lost: BoolArray, not_passed: BoolArray, lot: IntArray) -> IntervalEstimate | None:
    """r^2 of the two (N,); ``None`` where either is the same for all devices, or there are fewer than three lots."""
    _, index = numbered(lot)
    t, v = lost.astype(np.float64), not_passed.astype(np.float64)
    sums = np.stack([np.bincount(index, weights=w) for w in (np.ones_like(t), t, v, t * v)])
    lots = sums.shape[1]
    total = sums.sum(axis=1)
    r = _correlation(total)
    if lots < 3 or not math.isfinite(r):
        return None
    each = np.array([_correlation(total - sums[:, k]) for k in range(lots)])
    if not np.all(np.isfinite(each)):
        return None
    z, spread = math.atanh(min(r, _NEVER_ONE)), np.arctanh(np.minimum(each, _NEVER_ONE))
    if r >= _NEVER_ONE:
        # No verdict differs from the truth: the rule of three.  Hanley, Lippman-Hand, JAMA 249 (1983) 1743.
        n, p = float(total[0]), float(total[1] / total[0])
        return IntervalEstimate(1.0, 0.0, max(0.0, 1.0 - 3.0 / (n * p * (1.0 - p))), 1.0)
    sd = math.sqrt((lots - 1.0) / lots * float(np.sum((spread - spread.mean()) ** 2)))
    half = float(stdtrit(lots - 1.0, 0.5 * (1.0 + LEVEL))) * sd
    low, high = math.tanh(z - half), math.tanh(z + half)
    return IntervalEstimate(r * r, abs(2.0 * r * (1.0 - r * r)) * sd, max(low, 0.0) ** 2, high * high)


def _correlation(sums: FloatArray) -> float:
    """Correlation from n, sum t, sum v and sum t v of numbers that are 0 or 1; nan where one of them does not vary."""
    n, t, v, both = (float(one) for one in sums)
    spread = t * (n - t) * v * (n - v)
    return (n * both - t * v) / math.sqrt(spread) if spread > 0.0 else math.nan
