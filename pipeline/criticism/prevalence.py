"""Who carries a term, and how much of it: sizes fitted unit by unit, of which some are null.

    a_i ~ (1 - pi) N(0, sd_i^2) + pi N(mu, sd_i^2 + tau^2)      pi: the share that carries it

by maximum likelihood; the interval of pi is where twice the log likelihood is within chi2_1 at 95 % of its top.

Shapes: n units, each with a size, its sd, and a weight: how many units of the population it stands for.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize
from scipy.stats import chi2

from ..arrays import FloatArray


@dataclass(frozen=True)
class TermSizes:
    """Who carries a term and how much of it: share with its 95 % interval, mean size with its sd, spread (sd) of sizes."""

    share: float
    low: float
    high: float
    mean: float
    mean_sd: float
    spread: float


def prevalence(sizes: FloatArray, sds: FloatArray, weights: FloatArray) -> TermSizes:
    """Share of the units that carry a term, and the distribution of its size among them, by maximum likelihood.

    Parameters
    ----------
    sizes, sds : (n,) fitted size (value - null) of each unit and its sd.
    weights : (n,); the likelihood counts for (sum w)^2 / sum w^2 units.
    """
    known = np.isfinite(sizes) & np.isfinite(sds) & (sds > 0.0)
    if not known.any():
        return TermSizes(float("nan"), 0.0, 1.0, float("nan"), float("nan"), float("nan"))
    unit = float(np.sqrt(np.mean(sizes[known] ** 2))) or 1.0
    a, sd = sizes[known] / unit, sds[known] / unit
    w = weights[known] * (weights[known].sum() / np.sum(weights[known] ** 2))
    shares = np.linspace(0.0, 1.0, 51)
    best = [_mixture(a, sd, w, share) for share in shares]
    value = np.array([log_likelihood for log_likelihood, _, _ in best])
    top = int(np.argmax(value))
    inside = shares[value > value[top] - 0.5 * float(chi2.ppf(0.95, 1))]
    _, mean, spread = best[top]
    variance = sd**2 + spread**2
    r = _responsibility(a, sd, shares[top], mean, spread) * w
    mean_sd = 1.0 / np.sqrt(max(float(np.sum(r / variance)), 1e-300))
    return TermSizes(
        float(shares[top]), float(inside.min()), float(inside.max()), mean * unit, float(mean_sd) * unit, spread * unit
    )


def _log_parts(
    a: FloatArray, sd: FloatArray, share: float, mean: float, spread: float
) -> tuple[FloatArray, FloatArray]:
    variance = sd**2 + spread**2
    with np.errstate(divide="ignore"):
        null = np.log1p(-share) - 0.5 * (a / sd) ** 2 - np.log(sd) if share < 1.0 else np.full(a.size, -np.inf)
        carry = np.log(share) - 0.5 * (a - mean) ** 2 / variance - 0.5 * np.log(variance)
    return np.asarray(null), np.asarray(carry)


def _responsibility(a: FloatArray, sd: FloatArray, share: float, mean: float, spread: float) -> FloatArray:
    null, carry = _log_parts(a, sd, share, mean, spread)
    return np.asarray(np.exp(carry - np.logaddexp(null, carry)))


def _mixture(a: FloatArray, sd: FloatArray, w: FloatArray, share: float) -> tuple[float, float, float]:
    """Largest log likelihood at this share, with the mean and spread it has there; sizes in units of their rms."""

    def loss(p: FloatArray) -> float:
        null, carry = _log_parts(a, sd, share, float(p[0]), float(np.exp(p[1])))
        return -float(np.sum(w * np.logaddexp(null, carry)))

    loud = np.abs(a) / sd >= np.quantile(np.abs(a) / sd, max(1.0 - share, 0.0))
    start = np.array([float(np.median(a[loud])), np.log(max(float(np.std(a[loud])), 1e-3))])
    best = minimize(loss, start, method="Nelder-Mead", options={"xatol": 1e-3, "fatol": 1e-3, "maxfev": 120})
    spread = float(np.exp(best.x[1]))
    return -float(best.fun), float(best.x[0]), spread if spread > 1e-2 * float(np.median(sd)) else 0.0
