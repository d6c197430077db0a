"""Posterior of the spreads that matter most in a fitted lot, by emcee.

    p(s | y)  ~  L(s^2, v'(s)) prod_c 1 / (1 + s_c^2 / A^2),      s_c = sqrt(v_c), the ratio of a spread to that of the file

L is the restricted likelihood, so that means and patterns are integrated out exactly.  The other variances v' maximize it at s:
their Laplace marginal with a constant determinant, as in ln v, where the information hardly changes.  The chains run on a surface
through exact values (``profile``).  Exact values at draws of the chains check it, and join it until it agrees with new ones.
The prior is flat in the sd up to A = ``SCALE`` times the file's spread: with three units or more of a level it hardly matters,
and with fewer it keeps the posterior proper.

Influence of a spread: the width of its 90 % interval in the variance of a device, over the whole variance, in the quantity where
that is largest.  Walkers move by independence proposals, a multivariate t in w = ln(s + s0) around weighted pilot draws.

Source: Gelman, Bayesian Analysis 1 (2006) 515 (flat and half-Cauchy priors on the sd); Harville, Biometrika 61 (1974) 383
(restricted likelihood as a marginal one); Hastings, Biometrika 57 (1970) 97; Foreman-Mackey et al., PASP 125 (2013) 306.
Shapes: C random parts, S sampled ones, B points.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from ...arrays import FloatArray, IntArray
from ...inference.screening.convergence import rhat_and_ess, split_chains
from ..answers import Answer
from .model import contribution
from .profile import Profile
from .reml import LotFit

#: A of the prior: ten times the spread of the file.
SCALE = 10.0
#: Independent ensembles, walkers of each, steps of the first round and of the longest; criteria of convergence as for devices.
ENSEMBLES, WALKERS, STEPS, MOST_STEPS = 4, 12, 160, 1280
RHAT_MAX, ESS_MIN = 1.01, 1000.0
#: Degrees of freedom of the proposal, pilot draws, and rounds in which they improve it.
FREEDOM, PILOT, ROUNDS = 5.0, 100, 2
#: Draws at which the surface is checked, at random and farthest out, sd of its error in ln L, and most exact values.  With an
#: error of 0.13 the upper end of an interval was 0.38 sd too low (a balanced one-way design, seed 4), with 0.08 0.05 sd.
CHECKED, FARTHEST, AGREES, MOST_POINTS = 30, 10, 0.08, 600
#: Spreads that a request may name: the number of proposals that are wasted grows with it.
MOST = 6

LogDensity = Callable[[FloatArray], FloatArray]


class SpreadPosterior(Answer, frozen=True, eq=False):
    """Ratio of a spread to that of the file: posterior median and 90 % interval, and those of restricted maximum likelihood."""

    median: float
    low: float
    high: float
    reml: float
    reml_low: float
    reml_high: float


class LotPosteriorAnswer(Answer, frozen=True, eq=False):
    """Posterior of the most influential spreads.

    ``rhat``, ``ess``, ``acceptance`` : largest R-hat and smallest ESS of the spreads, share of accepted proposals.
    ``surface_error`` : sd of the error of ln L at draws of the chains.
    ``marginal`` : the other spreads, over which the posterior is marginal.
    """

    spreads: Mapping[str, SpreadPosterior]
    marginal: tuple[str, ...]
    rhat: float
    ess: float
    acceptance: float
    surface_error: float
    draws: int
    converged: bool


@dataclass(frozen=True, eq=False)
class SpreadDraws:
    """Draws (E, n, S) of the ratios s of the parts ``chosen`` (S,), and their convergence.

    ``surface_error`` is the sd of the error of ln L at some of the draws.
    """

    chosen: IntArray
    draws: FloatArray
    rhat: float
    ess: float
    acceptance: float
    surface_error: float

    @property
    def converged(self) -> bool:
        """Whether R-hat and ESS keep the limits that devices have, and the surface holds where the draws are."""
        return self.rhat <= RHAT_MAX and self.ess >= ESS_MIN and self.surface_error <= AGREES


def influential(fit: LotFit, count: int, intervals: FloatArray) -> IntArray:
    """(count,) numbers of the spreads that matter most, most first; ``intervals`` (C, 2) of sqrt(v).

    Spreads that the lot does not bound within the scale of the prior come last: their posterior is the prior.
    """
    each = np.stack([np.einsum("nii->i", contribution(part)) / len(part.columns) for part in fit.model.random])
    whole = np.maximum(fit.variances @ each, 1e-300)
    width = np.minimum(intervals[:, 1], SCALE) ** 2 - np.minimum(intervals[:, 0], SCALE) ** 2
    influence = np.max(width[:, None] * each / whole, axis=1)
    influence = np.where(intervals[:, 1] < SCALE, influence, -1.0)
    return np.argsort(-influence, kind="stable")[:count]


def sampled(fit: LotFit, chosen: IntArray, intervals: FloatArray, seed: int) -> SpreadDraws:
    """Draws of the ratios of the parts ``chosen`` (S,); ``intervals`` (C, 2) say where the pilot draws look."""
    centre, size = np.sqrt(fit.variances[chosen]), len(chosen)
    ends = np.clip(intervals[chosen], 0.0, np.maximum(3.0 * centre, SCALE)[:, None])
    offset = np.maximum(0.3 * ends[:, 1], 1e-3)
    none = np.zeros((0, size))
    known = Profile(fit, chosen, offset, none, none.sum(axis=1), np.zeros((0, len(fit.variances))))

    def prior(w: FloatArray) -> FloatArray:
        s = known.ratios(w)
        return np.where(np.all(s > 0.0, axis=1), np.sum(w - np.log1p((s / SCALE) ** 2), axis=1), -np.inf)

    middle = np.log(centre + offset)
    sd = np.maximum((np.log(ends[:, 1] + offset) - np.log(ends[:, 0] + offset)) / 3.3, 1e-3)
    random = np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=(119,))))
    factor = np.diag(sd)
    for _ in range(ROUNDS):
        unit = _t_draws(PILOT, size, random)
        w = middle + unit @ factor.T
        known = known.extended(w)
        middle, factor = _improved(w, prior(w) + known.values[-PILOT:] - _log_t(unit), middle, factor)
    while True:
        surface = known.surface(middle, factor)
        w, draws = _chains(partial(_log_density, prior, surface), middle, factor, chosen, offset, seed)
        flat = w.reshape(-1, size)
        # A walker that stays gives the same point twice.  The draws farthest out show where the surface is extrapolated.
        far = np.argsort(np.sum(((flat - middle) @ np.linalg.inv(factor).T) ** 2, axis=1))[-FARTHEST:]
        checked = np.unique(flat[[*random.choice(len(flat), CHECKED, replace=False), *far]], axis=0)
        expected = surface(checked)
        known = known.extended(checked)
        error = float(np.std(expected - known.values[-len(checked) :]))
        if error < AGREES or len(known.points) >= MOST_POINTS:
            return replace(draws, surface_error=error)
        middle, factor = flat.mean(axis=0), np.linalg.cholesky(np.cov(flat.T).reshape(size, size) + 1e-8 * np.eye(size))


def _log_density(prior: LogDensity, surface: LogDensity, w: FloatArray) -> FloatArray:
    found = prior(w)
    inside = np.isfinite(found)
    found[inside] += surface(w[inside])
    return found


def _log_t(unit: FloatArray) -> FloatArray:
    return np.asarray(-0.5 * (FREEDOM + unit.shape[1]) * np.log1p(np.sum(unit**2, axis=1) / FREEDOM))


def _t_draws(count: int, size: int, random: Any) -> FloatArray:
    normal = random.normal(size=(count, size))
    return np.asarray(normal * np.sqrt(FREEDOM / random.chisquare(FREEDOM, size=(count, 1))))


def _improved(
    points: FloatArray, log_weight: FloatArray, middle: FloatArray, factor: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Middle and Cholesky factor of the weighted pilot draws; wider ones around the best where too few of them count."""
    weight = np.exp(log_weight - np.max(log_weight))
    weight = weight / weight.sum()
    if 1.0 / np.sum(weight**2) < 5.0 * len(middle):
        return points[np.argmax(log_weight)], 1.5 * factor
    mean = weight @ points
    covariance = (points - mean).T @ ((points - mean) * weight[:, None])
    return mean, np.linalg.cholesky(covariance + 1e-8 * np.eye(len(mean)))


def _chains(
    log_density: LogDensity, middle: FloatArray, factor: FloatArray, chosen: IntArray, offset: FloatArray, seed: int
) -> tuple[FloatArray, SpreadDraws]:
    # emcee imports h5py, half a second of processor time, and most answers do without it.
    import emcee

    size = len(middle)
    back = np.linalg.inv(factor)

    def proposal(x: FloatArray, random: Any) -> tuple[FloatArray, FloatArray]:
        unit = _t_draws(len(x), size, random)
        return middle + unit @ factor.T, _log_t((x - middle) @ back.T) - _log_t(unit)

    parts: list[FloatArray] = [np.zeros((0, WALKERS, size)) for _ in range(ENSEMBLES)]
    samplers, states = [], []
    for k in range(ENSEMBLES):
        random = np.random.RandomState(np.random.MT19937(np.random.SeedSequence(seed, spawn_key=(120, k))))
        sampler = emcee.EnsembleSampler(WALKERS, size, log_density, moves=emcee.moves.MHMove(proposal), vectorize=True)
        sampler.random_state = random.get_state()
        start = middle + _t_draws(WALKERS, size, random) @ factor.T
        start = np.where(np.isfinite(log_density(start))[:, None], start, middle)
        samplers.append(sampler)
        states.append(sampler.run_mcmc(start, STEPS // 5, skip_initial_state_check=True))
        sampler.reset()
    steps = STEPS
    while True:
        for k, sampler in enumerate(samplers):
            states[k] = sampler.run_mcmc(states[k], steps - len(parts[k]), skip_initial_state_check=True)
            parts[k] = sampler.get_chain()
        # Steps of one walker are kept together, so that the ESS accounts for their autocorrelation.
        w = np.stack([own.transpose(1, 0, 2).reshape(-1, size) for own in parts])
        rhat, ess = rhat_and_ess(split_chains(w))
        accepted = float(np.mean([np.mean(sampler.acceptance_fraction) for sampler in samplers]))
        found = SpreadDraws(chosen, np.exp(w) - offset, float(rhat.max()), float(ess.min()), accepted, 0.0)
        if found.converged or steps >= MOST_STEPS:
            return w, found
        steps *= 2


def posterior(fit: LotFit, count: int, seed: int = 0) -> LotPosteriorAnswer:
    """Posterior of the ``count`` most influential spreads of a fit, beside their REML intervals."""
    intervals = fit.interval()
    chosen = influential(fit, min(count, len(fit.variances)), intervals)
    found = sampled(fit, chosen, intervals, seed)
    flat = found.draws.reshape(-1, len(chosen))
    low, median, high = np.quantile(flat, [0.05, 0.5, 0.95], axis=0)
    names: Sequence[str] = fit.model.names
    spreads = {
        names[k]: SpreadPosterior(
            float(median[i]),
            float(low[i]),
            float(high[i]),
            float(np.sqrt(fit.variances[k])),
            float(intervals[k, 0]),
            float(intervals[k, 1]),
        )
        for i, k in enumerate(chosen.tolist())
    }
    return LotPosteriorAnswer(
        spreads=spreads,
        marginal=tuple(name for k, name in enumerate(names) if k not in set(chosen.tolist())),
        rhat=found.rhat,
        ess=found.ess,
        acceptance=found.acceptance,
        surface_error=found.surface_error,
        draws=len(flat),
        converged=found.converged,
    )
