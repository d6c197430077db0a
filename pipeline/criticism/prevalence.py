"""Prevalence of a term among units, and the distribution of its size, from sizes fitted unit by unit.

    a_i ~ (1 - pi) N(0, sd_i^2) + pi N(mu, sd_i^2 + tau^2)      pi: prevalence, the share of units that have the term

by maximum likelihood; the 95 % interval of pi holds the values whose log likelihood is within chi2_1(95 %) / 2 of its maximum.

Sources: mixture models, McLachlan and Peel 2000; interval by the likelihood ratio, Wilks 1938.
Shapes: n units, each with a size, its sd, and a weight: the number of units of the population that it represents.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from ..arrays import FloatArray


@dataclass(frozen=True)
class TermSizes:
    """Prevalence of a term and its sizes, which have the unit of the parameter.

    Parameters
    ----------
    share, low, high : prevalence and its 95 % interval.
    mean, mean_sd : mean size among the units that have the term, and its sd.
    spread : sd of the sizes among these units.
    """

    share: float
    low: float
    high: float
    mean: float
    mean_sd: float
    spread: float


def prevalence(sizes: FloatArray, sds: FloatArray, weights: FloatArray) -> TermSizes:
    """Share of the units that have a term, and the distribution of its size among them, by maximum likelihood.

    Parameters
    ----------
    sizes, sds : (n,) fitted size (value - null) of each unit and its sd; units without a finite size and sd are ignored.
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
    inside = shares[value > value[top] - 0.5 * float(chdtri(1, 0.05))]
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
    """Log densities (n,) of both parts of the mixture, without the common constant."""
    variance = sd**2 + spread**2
    with np.errstate(divide="ignore"):
        null = np.log1p(-share) - 0.5 * (a / sd) ** 2 - np.log(sd) if share < 1.0 else np.full(a.size, -np.inf)
        present = np.log(share) - 0.5 * (a - mean) ** 2 / variance - 0.5 * np.log(variance)
    return np.asarray(null), np.asarray(present)


def _responsibility(a: FloatArray, sd: FloatArray, share: float, mean: float, spread: float) -> FloatArray:
    """Probability (n,) that each unit has the term."""
    null, present = _log_parts(a, sd, share, mean, spread)
    return np.asarray(np.exp(present - np.logaddexp(null, present)))


def _mixture(a: FloatArray, sd: FloatArray, w: FloatArray, share: float) -> tuple[float, float, float]:
    """Largest log likelihood at this share, with its mean and spread; sizes are in units of their rms."""

    def loss(p: FloatArray) -> float:
        null, present = _log_parts(a, sd, share, float(p[0]), float(np.exp(p[1])))
        return -float(np.sum(w * np.logaddexp(null, present)))

    strong = np.abs(a) / sd >= np.quantile(np.abs(a) / sd, max(1.0 - share, 0.0))
    start = np.array([float(np.median(a[strong])), np.log(max(float(np.std(a[strong])), 1e-3))])
    from scipy.optimize import minimize  # loading it takes a fifth of a second

    best = minimize(loss, start, method="Nelder-Mead", options={"xatol": 1e-3, "fatol": 1e-3, "maxfev": 120})
    spread = float(np.exp(best.x[1]))
    return -float(best.fun), float(best.x[0]), spread if spread > 1e-2 * float(np.median(sd)) else 0.0
