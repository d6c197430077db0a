"""Pass or fail of a device, as one fitted model sees it.

    draws ~ N(parameters, covariance)  ->  results quantities  ->  limits and rule of reports

A model that does not explain the records decides nothing: beyond the gate the verdict is "undecided", as in a run; what its
own sd would have said is told beside it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pipeline.device.gyro import PHYSICAL
from pipeline.device.operation.bias import quantities_of
from pipeline.experiment.record import Campaign
from pipeline.inference.gate import Gate, theta_bias_bound_deg
from pipeline.inference.general.fit import CampaignFit
from reports.decision import decide
from reports.limits import DEFAULT_LIMITS, Limits

_DRAWS, _SEED = 4000, 1


@dataclass(frozen=True)
class ModelVerdict:
    """``verdict`` pass, fail or undecided; ``at_face`` the same without the gate; ``failed_limits`` and why it was gated."""

    verdict: str
    ungated_verdict: str
    failed_limits: str
    reason: str = ""


def verdict_of(
    fit: CampaignFit, campaign: Campaign, limits: Limits = DEFAULT_LIMITS, gate: Gate | None = None
) -> ModelVerdict | None:
    """The verdict of one model of a gyro; ``None`` for any other plant.

    Parameters
    ----------
    fit : the model on the campaign.
    campaign : its angular gain and demodulation give the biases.
    limits : those of the shipped configuration without it.
    gate : beyond it a model decides nothing.
    """
    if fit.model.plant.kind != "gyro":
        return None
    gate = gate or Gate()
    random = np.random.default_rng(_SEED)
    draws = {name: np.full(_DRAWS, fit.values.get(name, 0.0)) for name in PHYSICAL}
    free = [i for i, name in enumerate(fit.names) if name in draws]
    covariance = fit.covariance[np.ix_(free, free)]
    if not np.all(np.isfinite(covariance)):
        return ModelVerdict("undecided", "undecided", "", "the records do not determine every parameter")
    values = random.multivariate_normal(np.zeros(len(free)), covariance, _DRAWS, method="eigh")
    for column, i in zip(values.T, free):
        draws[fit.names[i]] = draws[fit.names[i]] + column
    physical = np.stack([draws[name] for name in PHYSICAL], axis=-1)
    quantities = quantities_of(physical, campaign.angular_gain, campaign.phase_error_deg, campaign.drive)
    asked = {name: quantities[name][None] for name in limits.quantities}
    face = decide(limits, asked, ["ok"])
    reason = _gated(fit, gate)
    verdict = "undecided" if reason else face.verdict[0]
    return ModelVerdict(verdict, face.verdict[0], face.failed_limits[0], reason)


def _gated(fit: CampaignFit, gate: Gate) -> str:
    if not fit.fit_ok:
        return "the fit did not converge"
    error = fit.error["fit"]
    if fit.noise.source == "local" or error is None:
        return ""
    if error > gate.error_max:
        return f"error {error:.3g} above {gate.error_max:g}"
    sd = fit.theta_deg[1] if fit.theta_deg is not None else 0.0
    bound = theta_bias_bound_deg(sd, fit.chi2, fit.dof)
    if bound > gate.theta_bias_max_deg:
        return f"theta may be off by {bound:.2g} deg"
    return ""
