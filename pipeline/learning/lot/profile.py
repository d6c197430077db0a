"""Restricted likelihood of a few variances of a lot, with the others at their best, and a smooth surface through its values.

    l(s) = max over v' of ln L(s^2, v')         average-information steps on the other variances v'

A value costs up to ``FOLLOW`` factorizations and derivatives, so that chains run on a surface: a thin-plate interpolation (cubic)
in w = ln(s + s0) with a quadratic trend, through all values that are less than ``DEPTH`` below the best.

Source: Harville, Biometrika 61 (1974) 383 (restricted likelihood as a marginal one); Gilmour, Thompson, Cullis, Biometrics 51
(1995) 1440 (average information); Wendland, Scattered Data Approximation (2005), ch. 8 (radial basis functions).
Shapes: C random parts, S sampled ones, B points, N exact points.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import RBFInterpolator

from ...arrays import FloatArray, IntArray
from .derivatives import derivatives
from .elimination import factorised, log_likelihood, solved
from .reml import CEILING, FLOOR, LotFit, centred

#: Steps in which the other variances follow, and the rise of 2 ln L that is worth no more: a quarter of what ``AGREES`` allows.
FOLLOW, SETTLED = 20, 0.02
#: Variance at which every other part starts at least: from far below it, no step in ln v would find a rise.
RISE = 1e-2
#: ln L below the best, at which a value no longer matters: the tail of exp(-25) beside a posterior of 1000 draws.
DEPTH = 25.0


@dataclass(frozen=True, eq=False)
class Profile:
    """Exact values of the profile.

    Parameters
    ----------
    fit, chosen : the fit, and the numbers (S,) of the spreads that are sampled.
    offset : (S,) s0.
    points, values : (N, S) w and (N,) l(s) - l of the fit; -inf where s is negative or V is indefinite.
    variances : (N, C) all variances at the points.
    """

    fit: LotFit
    chosen: IntArray
    offset: FloatArray
    points: FloatArray
    values: FloatArray
    variances: FloatArray

    def ratios(self, w: FloatArray) -> FloatArray:
        """s of w."""
        return np.asarray(np.exp(w) - self.offset)

    def extended(self, w: FloatArray) -> Profile:
        """With exact values at w (B, S)."""
        values, variances = np.full(len(w), -np.inf), np.tile(self.fit.variances, (len(w), 1))
        known = np.flatnonzero(np.isfinite(self.values))
        for k, s in enumerate(self.ratios(w)):
            if np.any(s <= 0.0):
                continue
            start = self.fit.variances
            if known.size:
                # The other variances of the nearest point are near the best.
                start = self.variances[known[np.argmin(np.sum((self.points[known] - w[k]) ** 2, axis=1))]]
            try:
                value, variances[k] = profiled(self.fit, self.chosen, s**2, start)
            except np.linalg.LinAlgError:  # variances so far apart that rounding makes V indefinite
                continue
            values[k] = value - self.fit.log_likelihood
        return replace(
            self,
            points=np.concatenate([self.points, w]),
            values=np.concatenate([self.values, values]),
            variances=np.concatenate([self.variances, variances]),
        )

    def surface(self, middle: FloatArray, factor: FloatArray) -> Surface:
        """Through the values that matter; ``middle`` and ``factor`` (S, S) make the coordinates alike."""
        back = np.asarray(np.linalg.inv(factor), dtype=np.float64)
        high = self.values > np.max(self.values) - DEPTH
        x = (self.points[high] - middle) @ back.T
        return Surface(middle, back, RBFInterpolator(x, self.values[high], kernel="cubic", degree=2))


@dataclass(frozen=True, eq=False)
class Surface:
    """l at any w (B, S)."""

    middle: FloatArray
    back: FloatArray
    interpolator: RBFInterpolator

    def __call__(self, w: FloatArray) -> FloatArray:
        """(B,) interpolated values."""
        return np.asarray(self.interpolator((w - self.middle) @ self.back.T))


def profiled(fit: LotFit, chosen: IntArray, values: FloatArray, start: FloatArray) -> tuple[float, FloatArray]:
    """ln L where the variances of ``chosen`` are ``values`` (S,) and the others, from ``start`` (C,) on, maximize it.

    Also returns all variances (C,).

    Raises
    ------
    numpy.linalg.LinAlgError : variances so far apart that rounding makes V indefinite.
    """
    # A spread that was at zero may be needed where a sampled one is small.
    v = np.maximum(start, RISE)
    v[chosen] = np.clip(values, FLOOR, CEILING)
    others = np.setdiff1d(np.arange(len(v)), chosen)
    y = centred(fit.lot, fit.model)[..., None]
    factor = factorised(fit.design, v)
    solution = solved(factor, y)
    best = log_likelihood(factor, float(solution.quadratic[0]))
    damping = 1e-3
    for _ in range(FOLLOW if others.size else 0):
        if damping < 1.0:
            score, information = derivatives(factor, solution)
            score, inner = score[others], information[np.ix_(others, others)]
        step = np.linalg.solve(inner + np.diag(damping * np.diag(inner) + 1e-6 + 0.5 * np.maximum(-score, 0.0)), score)
        step = np.clip(step, -4.0, 2.0)
        if float(score @ step) < SETTLED:
            break
        trial = v.copy()
        trial[others] = np.clip(v[others] * np.exp(step), FLOOR, CEILING)
        other = factorised(fit.design, trial)
        found = solved(other, y)
        value = log_likelihood(other, float(found.quadratic[0]))
        if value > best:
            v, factor, solution, best, damping = trial, other, found, value, 1e-3
        else:
            damping = max(30.0 * damping, 1.0)
    return best, v
