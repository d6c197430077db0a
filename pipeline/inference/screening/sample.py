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

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...arrays import FloatArray
from .batch import Rows, local_rows, whole_rows
from .convergence import mean_ess, split_chains, split_rhat
from .fit import Fit

#: Degrees of freedom of the t proposal: bounded weights where the posterior has the tails of a normal.  In 100 default devices,
#: 200 degrees accept 0.98 of the proposals and 20 accept 0.83; the least ESS is 2222 and 1635.
_FREEDOM = 200.0
_PROBE = 256
#: Probes by which the few rows are compared with all rows, and the largest difference of the log likelihoods.
_COMPARED, _DIFFERENCE = 64, 1e-3
_MAX_STEPS = 6000
_LogDensity = Callable[[FloatArray], FloatArray]
#: (log density, start (E, n, P), steps L, random stream) -> points (E, n, L, P), accepted shares (E,)
_Chains = Callable[[_LogDensity, FloatArray, int, np.random.SeedSequence], tuple[FloatArray, FloatArray]]


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


def _generator(seed: np.random.SeedSequence) -> np.random.Generator:
    # Normals of SFC64 take 0.8 of the time of those of the default generator.
    return np.random.Generator(np.random.SFC64(seed))


def _t_draws(count: int, size: int, random: np.random.Generator) -> FloatArray:
    normal = random.standard_normal((count, size))
    normal *= np.sqrt(_FREEDOM / random.chisquare(_FREEDOM, size=(count, 1)))
    return normal


def diagnose(draws: FloatArray) -> tuple[float, float]:
    """Largest split R-hat [1] across ensembles and smallest ESS [draws] of the mean, over parameters of draws (E, n, P)."""
    chains = split_chains(draws)
    return float(np.max(split_rhat(chains))), float(np.min(mean_ess(chains)))


def _independence_chains(
    log_density: _LogDensity, start: FloatArray, steps: int, seed: np.random.SeedSequence
) -> tuple[FloatArray, FloatArray]:
    """Independence Metropolis-Hastings with the t proposal from start (E, n, P); points (E, n, L, P) and accepted shares (E,).

    A proposal y of x is accepted with the probability min(1, pi(y) t(x) / (pi(x) t(y))) (Hastings, Biometrika 57 (1970) 97),
    as by emcee's MHMove.  Walkers of such moves do not interact, and a proposal does not depend on where its walker is, so the
    densities of all proposals are one call.
    """
    count, walkers, size = start.shape
    together = count * walkers
    random = _generator(seed)
    every = np.concatenate([start.reshape(together, size), _t_draws(steps * together, size, random)])
    chance = np.log(random.random((steps, together)))
    log_weight = (log_density(every) - _log_t(every)).reshape(steps + 1, together)
    # Which of its proposals a walker is at; 0 is its start.
    at, own = np.zeros((steps + 1, together), dtype=np.int64), log_weight[0]
    accepted = np.zeros(count)
    for step in range(1, steps + 1):
        better = chance[step - 1] < log_weight[step] - own
        own = np.where(better, log_weight[step], own)
        at[step] = np.where(better, step, at[step - 1])
        accepted += np.count_nonzero(better.reshape(count, walkers), axis=1)
    points = every[at[1:].T * together + np.arange(together)[:, None]]
    return points.reshape(count, walkers, steps, size), accepted / (steps * walkers)


def _ensemble_chains(
    log_density: _LogDensity, start: FloatArray, steps: int, seed: np.random.SeedSequence
) -> tuple[FloatArray, FloatArray]:
    """Stretch and differential-evolution moves from start (E, n, P); points (E, n, L, P) and accepted shares (E,)."""
    # emcee imports scipy.stats and h5py, one second of processor time, and most devices do without it.
    import emcee

    points, shares = [], []
    for own, child in zip(start, seed.spawn(start.shape[0])):
        moves = [(emcee.moves.StretchMove(), 0.4), (emcee.moves.DEMove(), 0.5), (emcee.moves.DESnookerMove(), 0.1)]
        sampler = emcee.EnsembleSampler(*own.shape, log_density, moves=moves, vectorize=True)
        sampler.log_prob_fn = log_density  # emcee's wrapper prints a traceback of whatever the function raises
        sampler.random_state = np.random.RandomState(np.random.MT19937(child)).get_state()
        # Two points outside of the support cannot be compared: the fit is then no maximum.
        with np.errstate(invalid="raise"):
            sampler.run_mcmc(own, steps, skip_initial_state_check=True)
        points.append(sampler.get_chain().swapaxes(0, 1))
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
        return np.asarray(fit.x + unit @ factor.T)

    def run(name: str, chains: _Chains, steps: int, thin: int) -> Posterior:
        burn = settings.burn if thin == 1 else steps
        start = _t_draws(settings.ensembles * settings.walkers, size, random)
        start[~np.isfinite(log_posterior(start))] *= 1e-3
        together = start.reshape(settings.ensembles, settings.walkers, size)
        points, accepted = chains(log_posterior, together, burn + steps, seed.spawn(1)[0])
        # Steps of one walker are kept together, so that the ESS accounts for their autocorrelation.
        unit = points[:, :, burn + thin - 1 :: thin].reshape(settings.ensembles, -1, size)
        rhat, ess = diagnose(unit)
        return Posterior(points_of(unit), rhat, ess, float(np.mean(accepted)), importance, name)

    random = _generator(seed.spawn(1)[0])
    probe = _t_draws(_PROBE, size, random)
    rows = _sufficient_rows(fit, points_of(probe[:_COMPARED]))

    def log_posterior(unit: FloatArray) -> FloatArray:
        return rows.log_likelihood(points_of(unit))

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
