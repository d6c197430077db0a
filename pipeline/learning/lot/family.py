"""The p-values that the score tests of a lot share: a skewed null, and the best of many tests.

    family-wise     1 - (1 - p)^K,     K the number of independent tests
    skewed null     Pearson type III: a gamma variable with mean 0, sd 1 and the skewness of the drawn lots

Shapes: B drawn lots.  Source: Sidak, JASA 62 (1967) 626.
"""

from __future__ import annotations

import numpy as np
from scipy.stats import gamma

from ...arrays import FloatArray
from ...criticism.significance import log_any


def family_wise(log_p: float, tests: float) -> float:
    """Probability that any of ``tests`` independent tests shows a p-value below exp(``log_p``)."""
    return float(np.exp(log_any(log_p, tests)))


def independent_tests(log_p: FloatArray) -> float:
    """K of P(min p > x) = (1 - x)^K, by maximum likelihood over the drawn lots; ``log_p`` (tests, B)."""
    smallest = np.minimum(np.exp(log_p.min(axis=0)), 1.0 - 1e-12)
    return float(-smallest.size / np.sum(np.log1p(-smallest)))


def skewed_log_tail(z: FloatArray) -> FloatArray:
    """ln P(Z > z) (1 + B,) of a statistic in sds of its null; all but the first are drawn, and give the skewness."""
    skewness = max(float(np.mean(z[1:] ** 3)), 0.05)
    shape = 4.0 / skewness**2
    return np.asarray(gamma.logsf(shape + np.sqrt(shape) * z, shape))
