"""Posterior samples in independent ensembles, and their convergence.

The prior is uniform in the cartesian parameters (logarithms for the gains) where damping is positive semidefinite.  It is
rotation-invariant, so it prefers no orientation of the axes.

Where the Laplace approximation N(x^, V) is close (relative importance ESS of its draws above one half), the moves are
independence Metropolis-Hastings with a multivariate t proposal.  Elsewhere (boundaries, curved posteriors) a mixture of stretch
and differential-evolution moves of emcee runs until it converges or reaches the
largest number of steps.

Shapes: E ensembles, n walkers, L kept steps, 12 parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...arrays import FloatArray
from .compressed import Compressed
from .convergence import mean_ess, split_chains, split_rhat
from .fit import Fit
from .likelihood import log_likelihood

_FREEDOM = 20.0
_PROBE = 256
_MAX_STEPS = 6000
_LogDensity = Callable[[FloatArray], FloatArray]
#: (log density, start (E, n, P), steps, a random stream of each ensemble) -> points (L, E, n, P), accepted shares (E,)
_Chains = Callable[[_LogDensity, FloatArray, int, Sequence[Any]], tuple[FloatArray, FloatArray]]


@dataclass(frozen=True)
class SamplerSettings:
    """``ensembles`` ensembles of ``walkers`` walkers with ``burn`` discarded and ``steps`` kept steps; convergence limits."""

    ensembles: int = 4
    walkers: int = 96
    steps: int = 8
    burn: int = 2
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
    """Log density, up to a constant, of the multivariate t at whitened points (n, 12)."""
    size = unit.shape[1]
    return -0.5 * (_FREEDOM + size) * np.log1p(np.sum(unit**2, axis=1) / _FREEDOM)


def _t_draws(count: int, size: int, random: Any) -> FloatArray:
    normal = random.normal(size=(count, size))
    return np.asarray(normal * np.sqrt(_FREEDOM / random.chisquare(_FREEDOM, size=(count, 1))))


def diagnose(draws: FloatArray) -> tuple[float, float]:
    """Largest split R-hat [1] across ensembles and smallest ESS [draws] of the mean, over parameters of draws (E, n, P)."""
    chains = split_chains(draws)
    return float(np.max(split_rhat(chains))), float(np.min(mean_ess(chains)))


def _independence_chains(
    log_density: _LogDensity, start: FloatArray, steps: int, randoms: Sequence[Any]
) -> tuple[FloatArray, FloatArray]:
    """Independence Metropolis-Hastings with the t proposal from start (E, n, P); points (L, E, n, P) and accepted shares (E,).

    A proposal y of x is accepted with the probability min(1, pi(y) t(x) / (pi(x) t(y))) (Hastings, Biometrika 57 (1970) 97).
    Each ensemble has the random numbers of emcee's MHMove.  Walkers of such moves do not interact, so the densities of all
    ensembles are one call.
    """
    count, walkers, size = start.shape

    def log_weights(points: FloatArray) -> FloatArray:
        return log_density(points) - _log_t(points)

    points = np.empty((steps, count * walkers, size))
    accepted = np.zeros(count)
    x = start.reshape(-1, size)
    log_weight = log_weights(x)
    y, chance = np.empty_like(x), np.empty(count * walkers)
    for step in range(steps):
        for i, random in enumerate(randoms):
            own = slice(i * walkers, (i + 1) * walkers)
            random.random_sample()  # emcee draws which of its moves it makes
            y[own] = _t_draws(walkers, size, random)
            chance[own] = random.rand(walkers)
        proposed = log_weights(y)
        better = np.log(chance) < proposed - log_weight
        x, log_weight = np.where(better[:, None], y, x), np.where(better, proposed, log_weight)
        points[step] = x
        accepted += np.count_nonzero(better.reshape(count, walkers), axis=1)
    return points.reshape(steps, count, walkers, size), accepted / (steps * walkers)


def _ensemble_chains(
    log_density: _LogDensity, start: FloatArray, steps: int, randoms: Sequence[Any]
) -> tuple[FloatArray, FloatArray]:
    """Stretch and differential-evolution moves from start (E, n, P); points (L, E, n, P) and accepted shares (E,)."""
    # emcee imports scipy.stats and h5py, one second of processor time, and most devices do without it.
    import emcee

    points, shares = [], []
    for own, random in zip(start, randoms):
        moves = [(emcee.moves.StretchMove(), 0.4), (emcee.moves.DEMove(), 0.5), (emcee.moves.DESnookerMove(), 0.1)]
        sampler = emcee.EnsembleSampler(*own.shape, log_density, moves=moves, vectorize=True)
        sampler.log_prob_fn = log_density  # emcee's wrapper prints a traceback of whatever the function raises
        sampler.random_state = random.get_state()
        # Two points outside of the support cannot be compared: the fit is then no maximum.
        with np.errstate(invalid="raise"):
            sampler.run_mcmc(own, steps, skip_initial_state_check=True)
        points.append(sampler.get_chain())
        shares.append(float(np.mean(sampler.acceptance_fraction)))
    return np.stack(points, axis=1), np.array(shares)


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
    likelihood: Compressed = fit.likelihood
    size = fit.x.size
    scale = np.sqrt(np.diag(fit.covariance))
    factor = np.linalg.cholesky(fit.covariance / np.outer(scale, scale)) * scale[:, None]

    def log_posterior(unit: FloatArray) -> FloatArray:
        # Walkers move in whitened coordinates, because the scales of the parameters span twelve decades.
        points = fit.x + unit @ factor.T
        return log_likelihood(points, *likelihood.arrays)

    def run(name: str, chains: _Chains, steps: int, thin: int) -> Posterior:
        burn = settings.burn if thin == 1 else steps
        starts, randoms = [], []
        for stream in streams[: settings.ensembles]:
            random = np.random.RandomState()
            random.set_state(stream.get_state())
            randoms.append(random)
            starts.append(_t_draws(settings.walkers, size, stream))
        start = np.stack(starts)
        inside = np.isfinite(log_posterior(start.reshape(-1, size))).reshape(start.shape[:2])
        points, accepted = chains(
            log_posterior, np.where(inside[:, :, None], start, 1e-3 * start), burn + steps, randoms
        )
        # Steps of one walker are kept together, so that the ESS accounts for their autocorrelation.
        unit = points[burn + thin - 1 :: thin].transpose(1, 2, 0, 3).reshape(settings.ensembles, -1, size)
        rhat, ess = diagnose(unit)
        return Posterior(fit.x + unit @ factor.T, rhat, ess, float(np.mean(accepted)), importance, name)

    streams = [np.random.RandomState(np.random.MT19937(child)) for child in seed.spawn(settings.ensembles + 1)]
    probe = _t_draws(_PROBE, size, streams[-1])
    log_weight = log_posterior(probe) - _log_t(probe)
    weight = np.exp(log_weight - np.max(log_weight))
    importance = float(weight.sum() ** 2 / np.sum(weight**2) / _PROBE)

    if importance > 0.5:
        return run("laplace", _independence_chains, settings.steps, 1)
    steps, posterior = 1000, None
    while posterior is None or (steps <= _MAX_STEPS and not_converged_reason(posterior, settings) is not None):
        posterior = run("ensemble", _ensemble_chains, steps, steps // 50)
        steps *= 3
    return posterior


def not_converged_reason(posterior: Posterior, settings: SamplerSettings) -> str | None:
    """Why the draws are not sufficient, or ``None``."""
    if posterior.rhat <= settings.rhat_max and posterior.ess >= settings.ess_min:
        return None
    return (
        f"R-hat {posterior.rhat:.4g} (at most {settings.rhat_max:g}),"
        f" ESS {posterior.ess:.0f} (at least {settings.ess_min:g})"
    )
