"""Pass, fail or undecided: the verdict on a device according to one fitted model.

    draws ~ N(parameters, covariance)  ->  result quantities  ->  limits and rule of ``reports.decision``

A fit that the gate refuses gives the verdict "undecided", as in a run.  The verdict that its own sd would give is kept beside it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from msgspec.structs import replace

from pipeline.device.gyro import PHYSICAL
from pipeline.device.plant import C12
from pipeline.experiment.record import Campaign
from pipeline.inference.gate import Gate
from pipeline.inference.general.fit import CampaignFit
from pipeline.inference.general.goodness import fit_status, full_band_goodness
from pipeline.inference.systematic import Identified, rate_settings
from pipeline.learning.answers import RefinementAnswer, RungAnswer
from pipeline.learning.campaign.answers import CampaignAnswers
from reports.decision import decide
from reports.limits import Limits

from ..shipped import shipped_limits

_DRAWS, _SEED = 4000, 1


@dataclass(frozen=True)
class ModelVerdict:
    """``verdict`` and ``ungated_verdict`` pass, fail or undecided; ``failed_limits``; why the gate refused, else empty."""

    verdict: str
    ungated_verdict: str
    failed_limits: str
    reason: str = ""


def verdict_of(fit: CampaignFit, campaign: Campaign, limits: Limits, gate: Gate | None = None) -> ModelVerdict | None:
    """The verdict by P(conform) over draws N(parameters, covariance); ``None`` for a plant that is no gyro.

    Parameters
    ----------
    fit : the model fitted to the campaign.
    campaign : its angular gain and demodulation, for the rate biases.
    limits : by which the device is judged.
    gate : that of the shipped configuration by default; not applied where only a local fit shows the noise level.
    """
    if fit.model.plant.kind != "gyro":
        return None
    random = np.random.default_rng(_SEED)
    # c12 that is not in the model is zero; a mode that the layout does not show is unknown.
    draws = {name: np.full(_DRAWS, fit.values.get(name, 0.0 if name == C12 else np.nan)) for name in PHYSICAL}
    free = [i for i, name in enumerate(fit.names) if name in draws]
    covariance = fit.covariance[np.ix_(free, free)]
    if not np.all(np.isfinite(covariance)):
        return ModelVerdict("undecided", "undecided", "", "the records do not determine every parameter")
    values = random.multivariate_normal(np.zeros(len(free)), covariance, _DRAWS, method="eigh")
    for column, i in zip(values.T, free):
        draws[fit.names[i]] = draws[fit.names[i]] + column
    physical = np.stack([draws[name] for name in PHYSICAL], axis=-1)
    found = Identified.of_physical(physical, rate_settings(campaign)).draws
    ungated = decide(limits, {name: found[name][None] for name in limits.quantities}, ["ok"])
    goodness = full_band_goodness(fit) if fit.noise.known else None
    status, reason = fit_status(fit, campaign, goodness, gate or Gate())
    verdict = ungated.verdict[0] if status == "ok" else "undecided"
    return ModelVerdict(verdict, ungated.verdict[0], ungated.failed_limits[0], reason or "")


def with_verdicts(found: RefinementAnswer, answers: CampaignAnswers, own: Limits | None) -> RefinementAnswer:
    """The ladder with the verdict by each of its models, by ``own`` limits or the shipped ones; unchanged without a gyro."""
    problem = answers.problem
    if not problem.fit(()).ok or problem.model.plant.kind != "gyro":
        return found
    limits = own or shipped_limits(answers.fitted())
    if limits is None:
        return replace(found, limits="none")
    ladder = (_judged(rung, answers.fitted(rung.terms), problem.campaign, limits) for rung in found.ladder)
    return replace(found, ladder=tuple(ladder), limits="own" if own else "shipped")


def _judged(rung: RungAnswer, fit: CampaignFit, campaign: Campaign, limits: Limits) -> RungAnswer:
    """``rung`` with the verdict according to its model, ``fit``; unchanged if the plant is not a gyro."""
    found = verdict_of(fit, campaign, limits)
    if found is None:
        return rung
    reason = found.reason or found.failed_limits
    return replace(rung, verdict=found.verdict, verdict_at_face=found.ungated_verdict, verdict_reason=reason)
