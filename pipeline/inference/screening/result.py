"""Results of devices whose fit and posterior are known: scores of effects, quantities, status.

The devices of a part of a block go through the scores stage by stage.  The code of a stage then stays in the cache of the
processor: alone, a device takes 1.2 times as long for its scores.  Each device is computed as if it were alone, so
its result does not depend on the others.

Shapes: draws (n, P) of P cartesian parameters.  Results in the units of ``pipeline.quantities``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...arrays import FloatArray
from ...device.gyro import rocking_hz
from ..estimate import Estimate, estimate_from
from ..gate import Gate, GoodnessOfFit, Undetected
from ..moments import moments
from ..pickoff_noise import with_measured_noise
from ..systematic import Identified
from .fit import Fit
from .mismatch import MismatchPrior, without_tilt
from .quality import FullBandQuality
from .sample import Posterior, SamplerSettings, not_converged_reason
from .undetected.device import Scoring, scored_devices

Value = float | str | None

#: Why a device whose information matrix is singular has no result.
UNDETERMINED = "the records do not determine the parameters: the information matrix is singular"


@dataclass(frozen=True, eq=False)
class DeviceResult:
    """Columns of the devices table, the estimate from which they come, the fit, and its draws without common errors.

    The fit is ``None`` where it failed, the draws also where the tester has no common errors.
    """

    columns: dict[str, Value]
    estimate: Estimate
    fit: Fit | None
    identified: Identified | None = None


def failed_result(reason: str, columns: dict[str, Value] | None = None) -> DeviceResult:
    """The result of a device that could not be identified, with the columns that are known nevertheless."""
    return _without_estimate(Estimate("fit_failed", reason), columns or {})


def lost_result(reason: str) -> DeviceResult:
    """The result of a device that ended its worker or exceeded its time limit."""
    return _without_estimate(Estimate("lost", reason), {})


def _without_estimate(estimate: Estimate, columns: dict[str, Value]) -> DeviceResult:
    status: dict[str, Value] = {"status": estimate.status, "status_reason": estimate.reason}
    return DeviceResult({**columns, **status}, estimate, None)


@dataclass(frozen=True, eq=False)
class Fitted:
    """A device with its fit and posterior.

    Parameters
    ----------
    columns : of the devices table, as far as they are known.
    scoring : fit, data and noise.
    posterior, quality : its draws, and the quality of the fit in the full band.
    sampler, gate, seed : as for ``identify_device``.
    """

    columns: dict[str, Value]
    scoring: Scoring
    posterior: Posterior
    quality: FullBandQuality
    sampler: SamplerSettings
    gate: Gate
    seed: np.random.SeedSequence


def results_of(fitted: Sequence[Fitted | DeviceResult]) -> list[DeviceResult | Exception]:
    """The results of devices, in their order; what a device raises takes the place of its result."""
    waiting = [one for one in fitted if isinstance(one, Fitted)]
    scores = iter(scored_devices([one.scoring for one in waiting]))
    return [_finished(one, next(scores)) if isinstance(one, Fitted) else one for one in fitted]


def _finished(fitted: Fitted, undetected: Undetected | Exception) -> DeviceResult | Exception:
    if isinstance(undetected, np.linalg.LinAlgError):
        return failed_result(UNDETERMINED, fitted.columns)
    if isinstance(undetected, Exception):
        return undetected
    try:
        return _result(fitted, undetected)
    except Exception as error:
        return error


def _plant_draws(
    draws: FloatArray, prior: MismatchPrior | None, seed: np.random.SeedSequence
) -> tuple[FloatArray, dict[str, Value]]:
    """Cartesian draws (n, 12) of the plant from those of the fit (n, P), and the columns of the mismatches."""
    if prior is None:
        return draws, {}
    mismatches = np.ascontiguousarray(draws[:, 12:].T)
    ordered, half = np.sort(mismatches, axis=1), mismatches.shape[1] // 2
    middle, (_, variance) = 0.5 * (ordered[:, half] + ordered[:, -half - 1]), moments(mismatches)
    columns: dict[str, Value] = {}
    for i, name in enumerate(("drive_mismatch", "sense_mismatch")):
        columns |= {name: float(middle[i]), f"{name}_sd": float(np.sqrt(variance[i]))}
    return without_tilt(draws, prior, np.random.default_rng(seed.spawn(1)[0])), columns


def _result(fitted: Fitted, undetected: Undetected) -> DeviceResult:
    fit, posterior, quality, scoring = fitted.scoring.fit, fitted.posterior, fitted.quality, fitted.scoring
    plant, mismatch = _plant_draws(posterior.flat(), scoring.prior, fitted.seed)
    first_hz, second_hz = rocking_hz(fit.x)
    omega0_hz = first_hz if scoring.rate.drive == "f1" else second_hz
    rate = with_measured_noise(scoring.rate, scoring.noise, omega0_hz, plant.shape[0])
    identified = Identified.of_cartesian(plant, rate)
    estimate = estimate_from(
        identified.draws,
        GoodnessOfFit(quality.error_all_noise, fit.chi2, fit.dof, fit.likelihood.chi2_sd),
        fitted.gate,
        not_converged_reason(posterior, fitted.sampler),
        undetected,
    )
    columns = {
        **fitted.columns,
        **estimate.columns,
        **mismatch,
        **quality.columns(),
        **undetected.columns(),
        "rhat": posterior.rhat,
        "ess": posterior.ess,
        "acceptance": posterior.acceptance,
        "status": estimate.status,
        "status_reason": estimate.reason,
    }
    # The features of the band are large, and nothing after this needs them.
    small = replace(fit, likelihood=replace(fit.likelihood, columns=()))
    return DeviceResult(columns, estimate, small, None if rate.systematic.exact else identified)
