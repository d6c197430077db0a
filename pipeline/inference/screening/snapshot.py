"""What a record tells before it has ended: maximum likelihood and posterior of its first N samples.

    data v[0..N-1], S[0..N-1] from rest --exact transients--> x^, V --importance--> draws

Any N has an exact likelihood in the band, so a record that is still growing is judged as one that ended at N.  Draws are
those of a multivariate t around x^, resampled by posterior / proposal: some milliseconds, so that a stream keeps up.  Where
too few of them carry weight the posterior is still too broad for that, and the answer is that it is not known yet.

Shapes: N samples, n draws, 12 parameters.  Units as in ``pipeline.quantities``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ...arrays import FloatArray
from ..estimate import Estimate, RateSettings, cartesian_quantities, estimate_from
from ..gate import Gate, GoodnessOfFit, status_of
from .compressed import BandData, log_likelihood
from .device import best_fit, explains
from .fit import Fit

_FREEDOM = 20.0
_PROPOSALS = 4000
_DRAWS = 2000
#: How often a fit that has not settled is gone on with, and the fall of chi2 below which it is not.
_CONTINUED = 4
_FALLS = 0.95
#: How many of the starts that have not settled are gone on with.
_HOPEFUL = 2
#: Effective number of proposals below which a posterior is too far from normal to be known by them.
_LEAST_ESS = 200.0


@dataclass(frozen=True, eq=False)
class Snapshot:
    """The estimate from the first ``duration_s`` seconds of a record.

    ``x`` (12,) is the cartesian point from which the next snapshot may start its fit; ``None`` where nothing was found.
    """

    duration_s: float
    estimate: Estimate
    x: FloatArray | None


def posterior_draws(fit: Fit, seed: np.random.SeedSequence) -> tuple[FloatArray, bool]:
    """Cartesian posterior draws (n, 12), and whether they can be relied on.

    Parameters
    ----------
    fit : its maximum, covariance and compressed likelihood.
    seed : stream of these draws.

    Raises
    ------
    numpy.linalg.LinAlgError : the curvature of the likelihood is singular.
    """
    size = fit.x.size
    scale = np.sqrt(np.diag(fit.covariance))
    factor = np.linalg.cholesky(fit.covariance / np.outer(scale, scale)) * scale[:, None]
    random = np.random.default_rng(seed)
    unit = random.standard_normal((_PROPOSALS, size))
    unit *= np.sqrt(_FREEDOM / random.chisquare(_FREEDOM, size=(_PROPOSALS, 1)))
    points = fit.x + unit @ factor.T
    p = fit.likelihood
    log_weight = log_likelihood(points, p.expansion, p.triangle, p.data, fit.sigma_v)
    log_weight += 0.5 * (_FREEDOM + size) * np.log1p(np.sum(unit**2, axis=1) / _FREEDOM)
    weight = np.exp(log_weight - np.max(log_weight))
    weight /= weight.sum()
    # Systematic resampling adds the least noise of its own.
    places = (np.arange(_DRAWS) + random.uniform()) / _DRAWS
    kept = points[np.minimum(np.searchsorted(np.cumsum(weight), places), _PROPOSALS - 1)]
    return kept, bool(1.0 / np.sum(weight**2) >= _LEAST_ESS)


def _rank(fit: Fit) -> tuple[bool, float]:
    return fit.converged, -fit.chi2


def _continued(data: BandData, sigma_v: FloatArray, fit: Fit) -> Fit:
    """The fit gone on with while it has not settled but still falls: early starts are far away."""
    for _ in range(_CONTINUED):
        if fit.converged:
            break
        further = best_fit([data], sigma_v, [fit.x])
        if further is None or not (further.converged or further.chi2 < _FALLS * fit.chi2):
            break
        fit = further
    return fit


def _found(
    data: BandData, sigma_v: FloatArray, previous: FloatArray | None, starts: Callable[[], Sequence[FloatArray]]
) -> Fit | None:
    """The best fit from ``previous`` and, while none explains the data, from ``starts``; the most hopeful are gone on with."""
    fits: list[Fit] = []
    for start in [] if previous is None else [previous]:
        first = best_fit([data], sigma_v, [start])
        fits += [] if first is None else [_continued(data, sigma_v, first)]
    if not any(explains(fit) for fit in fits):
        for start in starts():
            other = best_fit([data], sigma_v, [start])
            fits += [] if other is None else [other]
            if other is not None and explains(other):
                break
        else:
            hopeful = sorted((fit for fit in fits if not fit.converged), key=lambda fit: fit.chi2)[:_HOPEFUL]
            fits += [_continued(data, sigma_v, fit) for fit in hopeful]
    return max(fits, key=_rank, default=None)


def snapshot(
    data: BandData,
    sigma_v: FloatArray,
    previous: FloatArray | None,
    starts: Callable[[], Sequence[FloatArray]],
    rate: RateSettings,
    gate: Gate,
    seed: np.random.SeedSequence,
) -> Snapshot:
    """The device from the data so far.

    Parameters
    ----------
    data : band, spectrum and nuisance basis of the first N samples, from rest.
    sigma_v : noise (2,) [V].
    previous : the fit of an earlier snapshot (12,), tried first.
    starts : further starting points, asked for only while the fit does not explain the data.
    rate, gate : as for ``identify_device``; the error is that of the band.
    seed : stream of the draws.

    Returns
    -------
    A snapshot in every case: what goes wrong is its status.
    """
    duration = data.band.samples / data.band.sample_rate_hz
    fit = _found(data, sigma_v, previous, starts)
    if fit is None or not fit.converged or fit.dof <= 0:
        failed = Estimate("fit_failed", "the likelihood has no maximum near any start yet")
        return Snapshot(duration, failed, None if fit is None else fit.x)
    return Snapshot(duration, _estimate(fit, rate, gate, seed), fit.x)


def _estimate(fit: Fit, rate: RateSettings, gate: Gate, seed: np.random.SeedSequence) -> Estimate:
    # The error of a few bins scatters more than that of a whole record: 3 sd of chi2 are taken off.
    error = math.sqrt(max(fit.chi2 / fit.dof - 3.0 * math.sqrt(2.0 / fit.dof), 0.0))
    goodness = GoodnessOfFit(error, fit.chi2, fit.dof)
    columns = {"chi2_per_dof": goodness.chi2_per_dof}
    status, reason = status_of(goodness, None, gate)
    if status != "ok":
        return Estimate(status, reason, columns)
    try:
        cartesian, known = posterior_draws(fit, seed)
    except (np.linalg.LinAlgError, ValueError):
        return Estimate("fit_failed", "the data do not determine the parameters yet")
    if not known:
        return Estimate("not_converged", "the posterior is still too broad for importance sampling", columns)
    return estimate_from(cartesian_quantities(cartesian, rate), goodness, gate)
