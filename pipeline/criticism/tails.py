"""Tails of chi-square and F in logarithms, where the plain functions have long been zero.

chi2_k(t):  h = t/2,  even k:  P = e^-h sum_{i < k/2} h^i / i!
                       odd k:  P = erfc(sqrt h) + e^-h sum_{1 <= i <= (k-1)/2} h^(i - 1/2) / Gamma(i + 1/2)
            many degrees of freedom:  log P = -h + (k/2 - 1) log h - log Gamma(k/2) + log(1 + (k/2 - 1)/h + ...)
F(k, nu):   P = I_x(nu/2, k/2),  x = nu / (nu + k f)
N trials:   P_N = 1 - (1 - P)^N
"""

from __future__ import annotations

import numpy as np
from scipy.special import betainc, betaln, erfcx, gamma, gammaincc, gammaln, log_ndtr

from ..arrays import FloatArray

_TINY = 1e-250
#: Up to here a closed form, exact however far out.
_FEW = 24


def log_tail(statistic: FloatArray | float, k: int, dof: int | None = None) -> FloatArray:
    """log P of a statistic (...) that is chi2_k, or k F(k, dof) where ``dof`` is given."""
    t = np.maximum(np.asarray(statistic, dtype=np.float64), 0.0)
    if dof is None and 0 < k <= _FEW:
        return _log_chi2(t, k)
    plain = gammaincc(k / 2.0, t / 2.0) if dof is None else betainc(dof / 2.0, k / 2.0, dof / (dof + t))
    near = np.log(np.maximum(plain, _TINY))
    if np.all(plain > _TINY):
        return np.asarray(near)
    far = _log_chi2_far(np.maximum(t, 1.0), k) if dof is None else _log_f_far(t, k, dof)
    return np.asarray(np.where(plain > _TINY, near, np.minimum(far, np.log(_TINY))))


def _log_chi2(t: FloatArray, k: int) -> FloatArray:
    half = t / 2.0
    if k % 2 == 0:
        total = np.ones_like(half)
        for i in range(k // 2 - 1, 0, -1):
            total = 1.0 + total * half / i
        return np.asarray(-half + np.log(total))
    root = np.sqrt(half)
    total = np.zeros_like(half)
    for i in range((k - 1) // 2, 0, -1):
        total = total * half + 1.0 / gamma(i + 0.5)
    return np.asarray(-half + np.log(erfcx(root) + total * root))


def _log_f_far(t: FloatArray, k: int, dof: int) -> FloatArray:
    x = dof / (dof + t)
    start = dof / 2.0 * np.log(x) + (k / 2.0 - 1.0) * np.log1p(-np.minimum(x, 0.5))
    return np.asarray(start - np.log(dof / 2.0) - betaln(dof / 2.0, k / 2.0))


def _log_chi2_far(t: FloatArray, k: int) -> FloatArray:
    half, a = t / 2.0, k / 2.0
    # Two terms of the asymptotic series, so that k = 1 and k = 4 tail off rightly beside one another.
    series = 1.0 + (a - 1.0) / half + (a - 1.0) * (a - 2.0) / half**2
    return np.asarray(-half + (a - 1.0) * np.log(half) - gammaln(a) + np.log(np.maximum(series, 1e-3)))


def log_any(log_p: FloatArray | float, trials: FloatArray | float) -> FloatArray:
    """log of the probability that any of ``trials`` independent tests (not necessarily whole) falls below p."""
    log_p = np.asarray(log_p, dtype=np.float64)
    p = np.exp(np.minimum(log_p, -1e-16))
    with np.errstate(divide="ignore"):
        exact = np.log(np.maximum(-np.expm1(trials * np.log1p(-p)), 1e-300))
    return np.asarray(np.where(log_p < -25.0, np.minimum(log_p + np.log(trials), 0.0), exact))


def trials_of(log_p: float, share: float) -> float:
    """N for which the quantile at ``share`` of the smallest of N tests is p:  log(1 - share) / log(1 - p)."""
    return float(np.log1p(-share) / np.log1p(-np.exp(min(log_p, -1e-12))))


def normal_log_tail(z: FloatArray | float) -> FloatArray:
    """log P(|N(0, 1)| > |z|)."""
    return np.asarray(np.log(2.0) + log_ndtr(-np.abs(z)))
