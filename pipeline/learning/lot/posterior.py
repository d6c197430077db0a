"""Posterior of the spreads that matter most in a fitted lot, by emcee.

    p(s | y)  ~  L(s^2, v'(s)) prod_c 1 / (1 + s_c^2 / A^2),      s_c = sqrt(v_c), the ratio of a spread to that of the file

L is the restricted likelihood, so that means and patterns are integrated out exactly.  The other variances v' maximize it at s
(average-information steps): their Laplace marginal with a constant determinant, as in ln v, where the information hardly changes.
The pilot draws maximize; the chains take v' from a quadratic of these, which costs a tenth and is wrong in second order only.
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
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...arrays import FloatArray, IntArray
from ...inference.screening.convergence import mean_ess, split_chains, split_rhat
from ..answers import Answer
from .derivatives import derivatives
from .elimination import factorised, log_likelihood, solved
from .model import contribution
from .reml import CEILING, FLOOR, LotFit, centred

#: A of the prior: ten times the spread of the file.
SCALE = 10.0
#: Independent ensembles, their walkers, steps of the first and of the longest round, limits of convergence as for devices.
ENSEMBLES, WALKERS, STEPS, MOST_STEPS = 4, 12, 40, 160
RHAT_MAX, ESS_MIN = 1.01, 1000.0
#: Degrees of freedom of the proposal, pilot draws, and rounds in which they improve it.
FREEDOM, PILOT, ROUNDS = 5.0, 100, 2
#: Steps in which the other variances follow, and the rise of 2 ln L that is worth no more: a tenth of what one sd costs.
FOLLOW, SETTLED = 6, 0.1
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
    ``marginal`` : the other spreads, over which the posterior is marginal.
    """

    spreads: Mapping[str, SpreadPosterior]
    marginal: tuple[str, ...]
    rhat: float
    ess: float
    acceptance: float
    draws: int
    converged: bool


@dataclass(frozen=True, eq=False)
class SpreadDraws:
    """Draws (E, n, S) of the ratios s of the parts ``chosen`` (S,), and their convergence."""

    chosen: IntArray
    draws: FloatArray
    rhat: float
    ess: float
    acceptance: float

    @property
    def converged(self) -> bool:
        """Whether R-hat and ESS keep the limits that devices have."""
        return self.rhat <= RHAT_MAX and self.ess >= ESS_MIN


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


def profiled(fit: LotFit, chosen: IntArray, values: FloatArray) -> tuple[float, FloatArray]:
    """ln L where the variances of ``chosen`` are ``values`` (S,) and the others maximize it, and all variances (C,).

    Raises
    ------
    numpy.linalg.LinAlgError : variances so far apart that rounding makes V indefinite.
    """
    v = fit.variances.copy()
    v[chosen] = np.clip(values, FLOOR, CEILING)
    others = np.setdiff1d(np.flatnonzero(~fit.at_zero), chosen)
    y = centred(fit.lot, fit.model)[..., None]
    best, at = -np.inf, v
    for _ in range(FOLLOW):
        factor = factorised(fit.design, v)
        solution = solved(factor, y)
        value = log_likelihood(factor, float(solution.quadratic[0]))
        if value <= best:
            break
        best, at = value, v
        if not others.size:
            break
        score, information = derivatives(factor, solution)
        inner = information[np.ix_(others, others)]
        damped = inner + np.diag(1e-3 * np.diag(inner) + 1e-6 + 0.5 * np.maximum(-score[others], 0.0))
        step = np.clip(np.linalg.solve(damped, score[others]), -2.0, 1.0)
        if float(score[others] @ step) < SETTLED:
            break
        v = v.copy()
        v[others] = np.clip(v[others] * np.exp(step), FLOOR, CEILING)
    return best, at


def sampled(fit: LotFit, chosen: IntArray, intervals: FloatArray, seed: int) -> SpreadDraws:
    """Draws of the ratios of the parts ``chosen`` (S,); ``intervals`` (C, 2) say where the pilot draws look."""
    centre = np.sqrt(fit.variances[chosen])
    ends = np.clip(intervals[chosen], 0.0, np.maximum(3.0 * centre, SCALE)[:, None])
    offset = np.maximum(0.3 * ends[:, 1], 1e-3)

    def prior(w: FloatArray) -> FloatArray:
        s = np.exp(w) - offset
        inside = np.all(s > 0.0, axis=1)
        return np.where(inside, np.sum(w - np.log1p((s / SCALE) ** 2), axis=1), -np.inf)

    def maximized(w: FloatArray) -> tuple[FloatArray, FloatArray]:
        found, at = prior(w), np.tile(np.log(fit.variances), (len(w), 1))
        for k in np.flatnonzero(np.isfinite(found)):
            try:
                value, v = profiled(fit, chosen, (np.exp(w[k]) - offset) ** 2)
            except np.linalg.LinAlgError:  # variances so far apart that rounding makes V indefinite
                found[k] = -np.inf
                continue
            found[k] += value - fit.log_likelihood
            at[k] = np.log(v)
        return found, at

    middle = np.log(centre + offset)
    sd = np.maximum((np.log(ends[:, 1] + offset) - np.log(ends[:, 0] + offset)) / 3.3, 1e-3)
    random = np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=(119,))))
    factor = np.diag(sd)
    points, values = np.zeros((0, len(chosen))), np.zeros((0, len(fit.variances)))
    for _ in range(ROUNDS):
        unit = _t_draws(PILOT, len(middle), random)
        w = middle + unit @ factor.T
        found, at = maximized(w)
        middle, factor = _improved(w, found - _log_t(unit), middle, factor)
        inside = np.isfinite(found)
        points, values = np.concatenate([points, w[inside]]), np.concatenate([values, at[inside]])
    others = np.setdiff1d(np.flatnonzero(~fit.at_zero), chosen)
    follow = _quadratic(points, values[:, others], middle, factor)

    def log_density(w: FloatArray) -> FloatArray:
        found = prior(w)
        inside = np.flatnonzero(np.isfinite(found))
        rest = follow(w)
        for k in inside:
            v = fit.variances.copy()
            v[others] = np.exp(rest[k])
            v[chosen] = np.clip((np.exp(w[k]) - offset) ** 2, FLOOR, CEILING)
            try:
                found[k] += fit.at(v) - fit.log_likelihood
            except np.linalg.LinAlgError:
                found[k] = -np.inf
        return found

    return _chains(log_density, middle, factor, chosen, offset, seed)


def _quadratic(points: FloatArray, values: FloatArray, middle: FloatArray, factor: FloatArray) -> LogDensity:
    """Quadratic least-squares surface of values (N, O) at points (N, S), within the range of the values."""
    back = np.linalg.inv(factor)
    upper = np.triu_indices(len(middle))

    def terms(w: FloatArray) -> FloatArray:
        # Beyond the points a quadratic leaves what they know.
        x = np.clip((w - middle) @ back.T, -4.0, 4.0)
        return np.concatenate([np.ones((len(x), 1)), x, (x[:, :, None] * x[:, None, :])[:, upper[0], upper[1]]], axis=1)

    slopes = np.linalg.lstsq(terms(points), values, rcond=1e-10)[0]
    low, high = values.min(axis=0), values.max(axis=0)
    return lambda w: np.asarray(np.clip(terms(w) @ slopes, low, high))


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
) -> SpreadDraws:
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
        chains = split_chains(w)
        accepted = float(np.mean([np.mean(sampler.acceptance_fraction) for sampler in samplers]))
        found = SpreadDraws(
            chosen, np.exp(w) - offset, float(split_rhat(chains).max()), float(mean_ess(chains).min()), accepted
        )
        if found.converged or steps >= MOST_STEPS:
            return found
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
        draws=len(flat),
        converged=found.converged,
    )
