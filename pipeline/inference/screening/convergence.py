"""Convergence of a sampled posterior: split R-hat and the effective sample size (ESS) of the mean.

Every ensemble is split in halves, which gives C chains x_c of n draws:

    R^2   = (B / W + n - 1) / n,         B = n var_c(mean x_c),   W = mean_c(var x_c)
    rho_t = 1 - (W - a_t) / V,           a_t = autocovariance at lag t, mean over chains (a_0 with n - 1),   V = W (n - 1)/n + B/n
    ESS   = C n / (-1 + 2 sum_t rho_t)   over Geyer's initial positive and monotone sequence of pairs rho_2k + rho_2k+1

Equal to arviz_stats (methods "split" and "mean"), without the lags that do not count.
Sources: Vehtari et al., Bayesian Analysis 16 (2021) 667; Geyer, Statist. Sci. 7 (1992) 473.

Shapes: E ensembles, n draws, P parameters, C = 2 E chains.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from ...arrays import FloatArray, by_column
from ..moments import moments

#: Range of draws that counts as none [unit of the draws], as in arviz_stats; and a variance, relative to the square of the mean,
#: that rounding can leave where all draws are equal.
_RESOLUTION, _ROUNDING = float(np.finfo(float).resolution), 1e-24


def split_chains(draws: FloatArray) -> FloatArray:
    """Halves (P, 2 E, n // 2) of the ensembles of draws (E, n, P), neighbours in memory along the last axis."""
    rows, n = by_column(draws), draws.shape[1]
    half = n // 2
    whole = rows if n % 2 == 0 else np.concatenate([rows[:, :, :half], rows[:, :, -half:]], axis=2)
    return np.ascontiguousarray(whole).reshape(rows.shape[0], 2 * rows.shape[1], half)


def rhat_and_ess(chains: FloatArray) -> tuple[FloatArray, FloatArray]:
    """R-hat (P,) [1], nan where all draws are equal, and ESS (P,) [draws] of the mean, of chains (P, C, n)."""
    count, n = chains.shape[1:]
    means, variances = moments(chains)
    between = means.var(axis=1, ddof=1)
    within = variances.mean(axis=1) * (n / (n - 1.0))
    with np.errstate(invalid="ignore", divide="ignore"):
        rhat = np.sqrt((n * between / within + n - 1.0) / n)
    times = np.empty(chains.shape[0])
    _autocorrelation_times(chains, means, between, times)
    ess = count * n / np.maximum(times, 1.0 / np.log10(count * n))
    # Two more passes over the draws, only where the variance may be rounding.
    for i in np.flatnonzero(within <= _ROUNDING * np.square(means).max(axis=1) + _RESOLUTION**2):
        if np.ptp(chains[i]) < _RESOLUTION:
            ess[i] = count * n
    return np.asarray(rhat), np.asarray(ess)


@njit(cache=True, fastmath={"contract", "reassoc", "nsz"})
def _covariance(chains: FloatArray, means: FloatArray, lag: int) -> float:
    """a_t: autocovariance at a lag, mean over chains (C, n) with the means (C,)."""
    count, n = chains.shape
    total = 0.0
    for c in range(count):
        for i in range(n - lag):
            total += (chains[c, i] - means[c]) * (chains[c, i + lag] - means[c])
    return total / (count * n)


@njit(cache=True, error_model="numpy")
def _autocorrelation_time(chains: FloatArray, means: FloatArray, between: float) -> float:
    """-1 + 2 sum rho_t over Geyer's sequences, of chains (C, n); the last odd term counts once where it is even.

    ``means`` (C,) are those of the chains, ``between`` is their variance B/n.  The lags after the end of the sequence are not
    computed.
    """
    n = chains.shape[1]
    within = _covariance(chains, means, 0) * n / (n - 1.0)
    whole = within * (n - 1.0) / n + between
    kept = np.zeros(n)
    kept[0] = 1.0
    kept[1] = 1.0 - (within - _covariance(chains, means, 1)) / whole
    even, odd, t = kept[0], kept[1], 1
    while t < n - 3 and even + odd > 0.0:
        even = 1.0 - (within - _covariance(chains, means, t + 1)) / whole
        odd = 1.0 - (within - _covariance(chains, means, t + 2)) / whole
        if even + odd >= 0.0:
            kept[t + 1], kept[t + 2] = even, odd
        t += 2
    last = t - 2
    if even > 0.0:
        kept[last + 1] = even
    for t in range(1, last - 1, 2):
        if kept[t + 1] + kept[t + 2] > kept[t - 1] + kept[t]:
            kept[t + 1] = kept[t + 2] = 0.5 * (kept[t - 1] + kept[t])
    return float(-1.0 + 2.0 * kept[: last + 1].sum() + kept[last + 1 : last + 2].sum())


@njit(cache=True, error_model="numpy")
def _autocorrelation_times(chains: FloatArray, means: FloatArray, between: FloatArray, out: FloatArray) -> None:
    """Fill ``out`` (P,) with the autocorrelation times of chains (P, C, n) with means (P, C) of variance ``between`` (P,)."""
    for i in range(out.size):
        out[i] = _autocorrelation_time(chains[i], means[i], between[i])
