"""Posterior samples in independent ensembles, and their convergence.

The prior is uniform in the cartesian parameters (logarithms for the gains) where damping is positive semidefinite.  It is
rotation-invariant, so it prefers no orientation of the axes.

Where the Laplace approximation N(x^, V) is close (relative importance ESS of its draws above one half), the moves are
independence Metropolis-Hastings with a multivariate t proposal.  Elsewhere (boundaries, curved posteriors) a mixture of stretch
and differential-evolution moves of emcee runs until it converges or reaches the largest number of steps.

Shapes: E ensembles, n walkers, L kept steps, P = 12 or 14 parameters.  In points (n, P) neighbouring points lie side by side in
memory, because all loops run along the points.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numba import njit

from ...arrays import FloatArray, IntArray, by_row
from .batch import Rows, local_rows, whole_rows
from .convergence import rhat_and_ess, split_chains
from .fit import Fit

#: Degrees of freedom of the t proposal: bounded weights where the posterior has the tails of a normal.  In 100 default devices,
#: 200 degrees accept 0.98 of the proposals and 20 accept 0.83; the least ESS is 2222 and 1635.
_FREEDOM = 200.0
#: Least number of Laplace draws that are judged; as many as there are walkers, which start there, if those are more.
_PROBE = 256
#: Probes by which the few rows are compared with all rows, and the largest difference of the log likelihoods.
_COMPARED, _DIFFERENCE = 64, 1e-3
_MAX_STEPS = 6000
#: ESS of a draw below which twice the steps are made: 2000 of the 3072 draws of the default.  Without it, the least ESS of 984
#: default devices was 1943, the median 2648.
_EFFICIENCY = 0.65
_LogDensity = Callable[[FloatArray], FloatArray]
#: (log density, start (E, n, P), its log densities (E, n), steps, those kept, random stream)
#: -> points (E, n, L, P), accepted shares (E,)
_Chains = Callable[
    [_LogDensity, FloatArray, FloatArray, int, slice, np.random.SeedSequence], tuple[FloatArray, FloatArray]
]


@dataclass(frozen=True)
class SamplerSettings:
    """``ensembles`` ensembles of ``walkers`` walkers with ``burn`` discarded and ``steps`` kept steps; convergence limits.

    Walkers start at Laplace draws.  Of their difference from the posterior, a move of independence chains leaves the share of
    proposals that are refused: 0.022 in the median of 1000 default devices, and 0.029 in 99 of 100.  With two discarded instead
    of one, no mean sd differs by more than twice its standard error of 6e-4.
    """

    ensembles: int = 4
    walkers: int = 96
    steps: int = 8
    burn: int = 1
    rhat_max: float = 1.01
    ess_min: float = 1000.0


@dataclass(frozen=True, eq=False)
class Posterior:
    """Cartesian draws (E, n L, 12); largest R-hat and smallest ESS of the parameters; mean acceptance.

    ``importance_ess`` is the relative ESS of the Laplace draws; ``move`` names the moves used.
    """

    draws: FloatArray
    rhat: float
    ess: float
    acceptance: float
    importance_ess: float
    move: str

    def flat(self) -> FloatArray:
        """All draws (E n L, 12) [units of ``device.gyro``]."""
        return self.draws.reshape(-1, self.draws.shape[-1])


def _log_t(unit: FloatArray) -> FloatArray:
    """Log density, up to a constant, of the multivariate t at whitened points (n, P)."""
    size = unit.shape[1]
    return -0.5 * (_FREEDOM + size) * np.log1p(np.einsum("ij,ij->i", unit, unit) / _FREEDOM)


def _generator(seed: np.random.SeedSequence) -> np.random.Generator:
    # A normal takes 0.83 of its time by numpy's default generator.
    return np.random.Generator(np.random.SFC64(seed))


def _t_draws(count: int, size: int, random: np.random.Generator) -> FloatArray:
    normal = random.standard_normal((size, count))
    normal *= np.sqrt(_FREEDOM / random.chisquare(_FREEDOM, size=count))
    return normal.T


def diagnose(draws: FloatArray) -> tuple[float, float]:
    """Largest split R-hat [1] across ensembles and smallest ESS [draws] of the mean, over parameters of draws (E, n, P)."""
    rhat, ess = rhat_and_ess(split_chains(draws))
    return float(np.max(rhat)), float(np.min(ess))


def _independence_chains(
    log_density: _LogDensity,
    start: FloatArray,
    density: FloatArray,
    steps: int,
    kept: slice,
    seed: np.random.SeedSequence,
) -> tuple[FloatArray, FloatArray]:
    """Independence Metropolis-Hastings with the t proposal from start (E, n, P); points (E, n, L, P) and accepted shares (E,).

    A proposal y of x is accepted with the probability min(1, pi(y) t(x) / (pi(x) t(y))) (Hastings, Biometrika 57 (1970) 97),
    as by emcee's MHMove.  Walkers of such moves do not interact, and a proposal does not depend on where its walker is, so the
    densities of all proposals are one call.
    """
    count, walkers, size = start.shape
    together = count * walkers
    random = _generator(seed)
    proposed = _t_draws(steps * together, size, random)
    chance = np.log(random.random((steps, together)))
    first = start.reshape(together, size)
    at = np.empty((steps, together), dtype=np.int64)
    moved = np.empty(together, dtype=np.int64)
    log_weight = (log_density(proposed) - _log_t(proposed)).reshape(steps, together)
    _walk(density.ravel() - _log_t(first), log_weight, chance, at, moved)
    points = np.concatenate([first.T, proposed.T], axis=1).take(at[kept].T.ravel(), axis=1)
    accepted = moved.reshape(count, walkers).sum(axis=1) / (steps * walkers)
    return by_row(points.reshape(size, count, walkers, -1)), accepted


@njit(cache=True)
def _walk(start: FloatArray, weight: FloatArray, chance: FloatArray, at: IntArray, moved: IntArray) -> None:
    """Fill ``at`` (L, n) with the points, start (n,) and proposals (L, n) in a row, that walkers are at; ``moved`` (n,) counts.

    start, weight : logarithms of the weights of the points; chance : those of uniform numbers.
    """
    steps, count = weight.shape
    for i in range(count):
        own, place, moves = start[i], i, 0
        for step in range(steps):
            if chance[step, i] < weight[step, i] - own:
                own, place, moves = weight[step, i], (step + 1) * count + i, moves + 1
            at[step, i] = place
        moved[i] = moves


def _ensemble_chains(
    log_density: _LogDensity,
    start: FloatArray,
    density: FloatArray,
    steps: int,
    kept: slice,
    seed: np.random.SeedSequence,
) -> tuple[FloatArray, FloatArray]:
    """Stretch and differential-evolution moves from start (E, n, P); points (E, n, L, P) and accepted shares (E,)."""
    # emcee imports scipy.stats and h5py, one second of processor time, and most devices do without it.
    import emcee

    points, shares = [], []
    for own, known, child in zip(start, density, seed.spawn(start.shape[0])):
        moves = [(emcee.moves.StretchMove(), 0.4), (emcee.moves.DEMove(), 0.5), (emcee.moves.DESnookerMove(), 0.1)]
        sampler = emcee.EnsembleSampler(*own.shape, log_density, moves=moves, vectorize=True)
        sampler.log_prob_fn = log_density  # emcee's wrapper prints a traceback of whatever the function raises
        sampler.random_state = np.random.RandomState(np.random.MT19937(child)).get_state()
        # Two points outside of the support cannot be compared: the fit is then no maximum.
        with np.errstate(invalid="raise"):
            sampler.run_mcmc(emcee.State(own, log_prob=known), steps, skip_initial_state_check=True)
        points.append(sampler.get_chain()[kept].swapaxes(0, 1))
        shares.append(float(np.mean(sampler.acceptance_fraction)))
    return np.stack(points), np.array(shares)


def sample(fit: Fit, settings: SamplerSettings, seed: np.random.SeedSequence) -> Posterior:
    """Sample the posterior around ``fit``.

    Parameters
    ----------
    fit : maximum-likelihood point, covariance and compressed likelihood.
    settings : sizes and convergence limits.
    seed : random stream of this device.

    Raises
    ------
    numpy.linalg.LinAlgError : the covariance is not positive definite.
    """
    size = fit.x.size
    scale = np.sqrt(np.diag(fit.covariance))
    factor = np.linalg.cholesky(fit.covariance / np.outer(scale, scale)) * scale[:, None]

    def points_of(unit: FloatArray) -> FloatArray:
        # Walkers move in whitened coordinates, because the scales of the parameters span twelve decades.
        points = factor @ unit.T
        points += fit.x[:, None]
        return np.asarray(points.T)

    walkers = settings.ensembles * settings.walkers
    probe = _t_draws(max(walkers, _PROBE), size, _generator(seed.spawn(1)[0]))
    rows = _sufficient_rows(fit, points_of(probe[:_COMPARED]))

    def log_posterior(unit: FloatArray) -> FloatArray:
        return rows.log_likelihood(points_of(unit))

    density = log_posterior(probe)
    log_weight = density - _log_t(probe)
    weight = np.exp(log_weight - np.max(log_weight))
    importance = float(weight.sum() ** 2 / np.sum(weight**2) / weight.size)
    outside = ~np.isfinite(density)
    if outside.any():
        probe[outside] *= 1e-3
        density[outside] = log_posterior(probe[outside])

    def run(name: str, chains: _Chains, steps: int, thin: int) -> Posterior:
        burn = settings.burn if thin == 1 else steps
        points, accepted = chains(
            log_posterior,
            probe[:walkers].reshape(settings.ensembles, settings.walkers, size),
            density[:walkers].reshape(settings.ensembles, settings.walkers),
            burn + steps,
            slice(burn + thin - 1, None, thin),
            seed.spawn(1)[0],
        )
        # Steps of one walker are kept together, so that the ESS accounts for their autocorrelation.
        unit = points.reshape(settings.ensembles, -1, size)
        rhat, ess = diagnose(unit)
        draws = points_of(unit.reshape(-1, size)).reshape(unit.shape)
        return Posterior(draws, rhat, ess, float(np.mean(accepted)), importance, name)

    if importance > 0.5:
        found = run("laplace", _independence_chains, settings.steps, 1)
        if found.ess >= _EFFICIENCY * settings.steps * walkers:
            return found
        return run("laplace", _independence_chains, 2 * settings.steps, 1)
    steps, posterior = 1000, None
    while posterior is None or (steps <= _MAX_STEPS and not_converged_reason(posterior, settings) is not None):
        posterior = run("ensemble", _ensemble_chains, steps, steps // 50)
        steps *= 3
    return posterior


def _sufficient_rows(fit: Fit, points: FloatArray) -> Rows:
    """The few rows that matter near the maximum, where they give the likelihood of ``points`` (n, P); all rows elsewhere."""
    few, whole = local_rows(fit.likelihood, fit.x), whole_rows(fit.likelihood)
    expected = whole.log_likelihood(points)
    inside = np.isfinite(expected)
    difference = np.abs(few.log_likelihood(points[inside]) - expected[inside])
    return few if np.max(difference, initial=0.0) <= _DIFFERENCE else whole


def not_converged_reason(posterior: Posterior, settings: SamplerSettings) -> str | None:
    """Why the draws are not sufficient, or ``None``."""
    if posterior.rhat <= settings.rhat_max and posterior.ess >= settings.ess_min:
        return None
    return (
        f"R-hat {posterior.rhat:.4g} (at most {settings.rhat_max:g}),"
        f" ESS {posterior.ess:.0f} (at least {settings.ess_min:g})"
    )
