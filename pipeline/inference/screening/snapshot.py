"""Snapshot of a record that still grows: maximum likelihood and posterior from its first N samples.

    data v[0..N-1], S[0..N-1] from rest --exact transients--> x^, V --importance resampling--> draws

The likelihood in the band is exact for any N, so a growing record is treated as one that ended at N.  The draws come from a
multivariate t around x^ and are resampled by posterior / proposal, which takes milliseconds.  If the weights are concentrated
on too few draws, the posterior is still too broad for this method and the status is "not_converged".

Shapes: N samples, n draws, 12 parameters.  Units as in ``pipeline.quantities``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ...arrays import FloatArray
from ..estimate import Estimate, RateSettings, estimate_from
from ..gate import Gate, GoodnessOfFit, status_of
from ..systematic import Identified
from .batch import whole_rows
from .compressed import BandData
from .device import best_fit, explains
from .fit import Fit
from .mismatch import MismatchPrior, without_tilt

_FREEDOM = 20.0
_PROPOSALS = 4000
_DRAWS = 2000
#: How often a fit that has not converged is continued, and the ratio of chi2 above which it is given up.
_CONTINUED, _LEAST_DECREASE = 4, 0.95
#: How many of the fits that have not converged are continued.
_BEST = 2
#: Effective number of proposals below which importance sampling is not reliable.
_LEAST_ESS = 200.0


@dataclass(frozen=True, eq=False)
class Snapshot:
    """The estimate from the first ``duration_s`` [s] of a record.

    ``x`` (12,) is the cartesian point from which the next snapshot may start its fit; ``None`` where nothing was found.
    """

    duration_s: float
    estimate: Estimate
    x: FloatArray | None


def posterior_draws(fit: Fit, seed: np.random.SeedSequence) -> tuple[FloatArray, bool]:
    """Posterior draws (n, P) [units of ``device.gyro``, mismatches 1], and whether their effective number suffices.

    Parameters
    ----------
    fit : maximum-likelihood point, covariance and compressed likelihood.
    seed : stream of these draws.

    Raises
    ------
    numpy.linalg.LinAlgError : the covariance is not positive definite.
    """
    size = fit.x.size
    scale = np.sqrt(np.diag(fit.covariance))
    factor = np.linalg.cholesky(fit.covariance / np.outer(scale, scale)) * scale[:, None]
    random = np.random.default_rng(seed)
    unit = random.standard_normal((_PROPOSALS, size))
    unit *= np.sqrt(_FREEDOM / random.chisquare(_FREEDOM, size=(_PROPOSALS, 1)))
    points = fit.x + unit @ factor.T
    log_weight = whole_rows(fit.likelihood).log_likelihood(points)
    log_weight += 0.5 * (_FREEDOM + size) * np.log1p(np.sum(unit**2, axis=1) / _FREEDOM)
    weight = np.exp(log_weight - np.max(log_weight))
    weight /= weight.sum()
    # Systematic resampling has the smallest variance.
    places = (np.arange(_DRAWS) + random.uniform()) / _DRAWS
    kept = points[np.minimum(np.searchsorted(np.cumsum(weight), places), _PROPOSALS - 1)]
    return kept, bool(1.0 / np.sum(weight**2) >= _LEAST_ESS)


def _rank(fit: Fit) -> tuple[bool, float]:
    return fit.converged, -fit.chi2


def _continued(data: BandData, sigma_v: FloatArray, fit: Fit, prior: MismatchPrior | None) -> Fit:
    """The fit continued while it has not converged but chi2 still decreases: starts from few samples are far away."""
    for _ in range(_CONTINUED):
        if fit.converged:
            break
        further = best_fit([data], sigma_v, [fit.x], prior)
        if further is None or not (further.converged or further.chi2 < _LEAST_DECREASE * fit.chi2):
            break
        fit = further
    return fit


def _found(
    data: BandData,
    sigma_v: FloatArray,
    previous: FloatArray | None,
    starts: Callable[[], Sequence[FloatArray]],
    prior: MismatchPrior | None,
) -> Fit | None:
    """The best fit from ``previous`` and, if that does not explain the data, from ``starts``; the best are continued."""
    fits: list[Fit] = []
    for start in [] if previous is None else [previous]:
        first = best_fit([data], sigma_v, [start], prior)
        fits += [] if first is None else [_continued(data, sigma_v, first, prior)]
    if not any(explains(fit) for fit in fits):
        for start in starts():
            other = best_fit([data], sigma_v, [start], prior)
            fits += [] if other is None else [other]
            if other is not None and explains(other):
                break
        else:
            unfinished = sorted((fit for fit in fits if not fit.converged), key=lambda fit: fit.chi2)[:_BEST]
            fits += [_continued(data, sigma_v, fit, prior) for fit in unfinished]
    return max(fits, key=_rank, default=None)


def snapshot(
    data: BandData,
    sigma_v: FloatArray,
    previous: FloatArray | None,
    starts: Callable[[], Sequence[FloatArray]],
    rate: RateSettings,
    gate: Gate,
    seed: np.random.SeedSequence,
    prior: MismatchPrior | None = None,
) -> Snapshot:
    """Fit and posterior of the data so far.

    Parameters
    ----------
    data : band, spectrum and nuisance basis of the first N samples, from rest.
    sigma_v : noise (2,) [V], unless ``data`` has its own.
    previous : point (P,) of an earlier snapshot, tried first.
    starts : gives further start values (12,); called only if the fit from ``previous`` does not explain the data.
    rate, gate : as for ``identify_device``; the gate judges the error in the band.
    seed : stream of the draws.
    prior : of the electrode mismatches; ``None``: they are not in the model.

    Returns
    -------
    A snapshot in every case; a failure is reported as its status.
    """
    duration = data.band.samples / data.band.sample_rate_hz
    fit = _found(data, sigma_v, previous, starts, prior)
    if fit is None or not fit.converged or fit.dof <= 0:
        failed = Estimate("fit_failed", "the likelihood has no maximum near any start yet")
        return Snapshot(duration, failed, None if fit is None else fit.x)
    return Snapshot(duration, _estimate(fit, rate, gate, seed, prior), fit.x)


def _estimate(
    fit: Fit, rate: RateSettings, gate: Gate, seed: np.random.SeedSequence, prior: MismatchPrior | None
) -> Estimate:
    # The error of a few bins scatters more than that of a whole record, so 3 sd of chi2 are subtracted.
    sd = fit.likelihood.chi2_sd or math.sqrt(2.0 * fit.dof)
    error = math.sqrt(max((fit.chi2 - 3.0 * sd) / fit.dof, 0.0))
    goodness = GoodnessOfFit(error, fit.chi2, fit.dof, fit.likelihood.chi2_sd)
    columns = {"chi2_per_dof": goodness.chi2_per_dof}
    status, reason = status_of(goodness, None, gate)
    if status != "ok":
        return Estimate(status, reason, columns)
    try:
        draws, known = posterior_draws(fit, seed)
    except (np.linalg.LinAlgError, ValueError):
        return Estimate("fit_failed", "the data do not determine the parameters yet")
    if not known:
        return Estimate("not_converged", "the posterior is still too broad for importance sampling", columns)
    plant = draws if prior is None else without_tilt(draws, prior, np.random.default_rng(seed.spawn(1)[0]))
    return estimate_from(Identified.of_cartesian(plant, rate).draws, goodness, gate)
