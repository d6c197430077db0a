"""Convergence of a sampled posterior: split R-hat and the effective sample size (ESS) of the mean.

Every ensemble is split in halves, which gives C chains x_c of n draws:

    R^2   = (B / W + n - 1) / n,         B = n var_c(mean x_c),   W = mean_c(var x_c)
    rho_t = 1 - (W - a_t) / V,           a_t = autocovariance at lag t, mean over chains (a_0 with n - 1),   V = W (n - 1)/n + B/n
    ESS   = C n / (-1 + 2 sum_t rho_t)   over Geyer's initial positive and monotone sequence of pairs rho_2k + rho_2k+1

Equal to arviz_stats (methods "split" and "mean"), computed for all parameters at once.
Sources: Vehtari et al., Bayesian Analysis 16 (2021) 667; Geyer, Statist. Sci. 7 (1992) 473.

Shapes: E ensembles, n draws, P parameters, C = 2 E chains.
"""

from __future__ import annotations

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

from ...arrays import FloatArray


def split_chains(draws: FloatArray) -> FloatArray:
    """Halves (P, 2 E, n // 2) of the ensembles of draws (E, n, P)."""
    half = draws.shape[1] // 2
    chains = np.concatenate([draws[:, :half], draws[:, -half:]])
    return np.ascontiguousarray(np.moveaxis(chains, -1, 0))


def split_rhat(chains: FloatArray) -> FloatArray:
    """R-hat (P,) [1] of chains (P, C, n); nan where all draws are equal."""
    n = chains.shape[2]
    between = n * chains.mean(axis=2).var(axis=1, ddof=1)
    within = chains.var(axis=2, ddof=1).mean(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.sqrt((between / within + n - 1.0) / n))


def mean_ess(chains: FloatArray) -> FloatArray:
    """ESS (P,) [draws] of the mean, of chains (P, C, n)."""
    count, n = chains.shape[1:]
    means = chains.mean(axis=2)
    size = next_fast_len(2 * n, real=True)
    spectrum = rfft(chains - means[:, :, None], n=size, axis=2)
    # The mean autocovariance is the transform of the mean power.
    power = np.mean(spectrum.real**2 + spectrum.imag**2, axis=1)
    covariance = irfft(power, n=size, axis=1)[:, :n] / n
    within = covariance[:, 0] * n / (n - 1.0)
    total = within * (n - 1.0) / n + means.var(axis=1, ddof=1)
    out = np.full(chains.shape[0], float(count * n))
    for i in np.flatnonzero(~(np.ptp(chains, axis=(1, 2)) < np.finfo(float).resolution)):
        rho = 1.0 - (within[i] - covariance[i]) / total[i]
        rho[0] = 1.0
        tau = max(_autocorrelation_time(rho), 1.0 / np.log10(count * n))
        out[i] = count * n / tau
    return out


def _autocorrelation_time(rho: FloatArray) -> float:
    """-1 + 2 sum rho_t over Geyer's sequences, of autocorrelations rho (n,); the last odd term counts once where it is even."""
    draws = rho.size
    kept = np.zeros(draws)
    kept[:2] = rho[:2]
    even, odd, t = rho[0], rho[1], 1
    while t < draws - 3 and even + odd > 0.0:
        even, odd = rho[t + 1], rho[t + 2]
        if even + odd >= 0.0:
            kept[t + 1 : t + 3] = even, odd
        t += 2
    last = t - 2
    if even > 0.0:
        kept[last + 1] = even
    for t in range(1, last - 1, 2):
        if kept[t + 1] + kept[t + 2] > kept[t - 1] + kept[t]:
            kept[t + 1 : t + 3] = 0.5 * (kept[t - 1] + kept[t])
    return float(-1.0 + 2.0 * kept[: last + 1].sum() + kept[last + 1 : last + 2].sum())
