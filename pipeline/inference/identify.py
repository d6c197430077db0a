"""Identify the device of a campaign: one entry point for every plant.

    two drives, two senses, hold "zoh" or "foh", at rest, noise measured, no model given  ->  in-band likelihood, posterior draws
    anything else                                                                         ->  general fit, normal intervals

Both paths apply the same gate and the same status rule.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ..arrays import FloatArray
from ..device.model import SCREENING_MODEL, Model, PlantSpec, mains_effects
from ..experiment.bad_samples import without_bad_samples
from ..experiment.noise.level import noise_level
from ..experiment.noise.lines import hum_line
from ..experiment.record import Campaign
from ..performance.figure import unknown_figures
from .estimate import normal_intervals, reference_comparison
from .gate import Gate
from .general.fit import fit_campaign
from .general.goodness import campaign_status
from .general.starts import driven_band
from .screening.campaign import identify_campaign, is_inband
from .screening.device import IdentificationSettings
from .screening.mismatch import BROAD, NIGHTLY_MODEL
from .screening.result import failed_result
from .screening.sample import SamplerSettings
from .systematic import rate_settings, with_common_errors

#: A chirp has 1 % of its power up to so much of its band beyond its ends.
_MARGIN = 0.05


@dataclass(frozen=True, eq=False)
class Identification:
    """What was identified.

    Parameters
    ----------
    columns : the columns of the devices table that apply, in their units.  ``effects_scored`` tells whether the effects of the
        library that the model lacks were scored: in-band only.
    reference : quantity -> comparison with the [reference] value of the campaign.
    draws : quantity -> (n,) posterior draws; empty without a posterior.
    """

    columns: dict[str, Any]
    reference: dict[str, dict[str, float]]
    draws: dict[str, FloatArray] = field(default_factory=dict)


def identify(
    campaign: Campaign,
    model: Model | None = None,
    settings: IdentificationSettings | None = None,
    sampler: SamplerSettings | None = None,
    gate: Gate | None = None,
    seed: int = 1,
) -> Identification:
    """Identify the device of ``campaign`` from its fit records; from all records where none has the role "fit".

    Parameters
    ----------
    campaign : any numbers of drives and senses.
    model : plant and effects for the general fit; ``None`` chooses the path and the model by the campaign.
    settings, sampler, gate : those of the default run without them.
    seed : of the posterior draws.

    Raises
    ------
    MeasurementError : nothing to fit, no noise, or too many bad samples.
    ConfigError : a model that does not apply to the records.
    """
    settings, gate = settings or IdentificationSettings(mismatch=BROAD), gate or Gate()
    if not campaign.with_role("fit"):
        campaign = replace(campaign, records=tuple(replace(r, role="fit") for r in campaign.records))
    campaign = without_bad_samples(campaign)
    settings = in_driven_band(settings, campaign)
    draws: dict[str, FloatArray] = {}
    if model is None and is_inband(campaign) and noise_level(campaign).known:
        stream = np.random.SeedSequence(seed)
        try:
            result = identify_campaign(campaign, settings, sampler or SamplerSettings(), gate, stream)
            draws, columns = result.estimate.draws, result.columns | _unknown(campaign, result.columns)
        except (ArithmeticError, ValueError, np.linalg.LinAlgError) as error:
            # Records that no device could have made; as for a device of a run.
            columns = failed_result(f"{type(error).__name__}: {error}").columns
    else:
        columns = _general_columns(campaign, model, settings, gate)
    bad = [
        {"record": record.name, "channel": f"sense{one.channel + 1}", **one.seconds(record.sample_rate_hz)}
        for record in campaign.records
        for one in record.bad or ()
    ]
    found: dict[str, Any] = {
        "device_id": campaign.device_id,
        **columns,
        "effects_scored": "effect_p_value" in columns,
        **({"bad_samples": bad} if bad else {}),
    }
    return Identification(found, reference_comparison(campaign.reference, columns), draws)


def _unknown(campaign: Campaign, columns: Mapping[str, Any]) -> dict[str, Any]:
    """``figures_unknown``: performance figure -> what would have to be declared; nothing where all are known."""
    rate = rate_settings(campaign)
    # The silence that the in-band fit needs shows the noise of the pick-offs.
    measured = replace(rate.operation, pickoff_noise_v=1.0)
    needed = unknown_figures(replace(rate, operation=measured).point)
    unknown = {name: list(needed[name]) for name in needed if name not in columns}
    return {"figures_unknown": unknown} if unknown and "theta_deg" in columns else {}


def in_driven_band(settings: IdentificationSettings, campaign: Campaign) -> IdentificationSettings:
    """``settings`` with the band of the drives where that is not inside the band of the settings.

    Raises
    ------
    MeasurementError : no fit record is driven.
    """
    low_hz, high_hz = driven_band(campaign.with_role("fit"))
    margin = _MARGIN * (settings.high_hz - settings.low_hz)
    if settings.low_hz - margin <= low_hz and high_hz <= settings.high_hz + margin:
        return settings
    return replace(settings, low_hz=low_hz, high_hz=high_hz)


def default_models(campaign: Campaign) -> tuple[Model, ...]:
    """Models to try without a model file: the nightly gyro for 2 x 2, else one mode, sensed as velocity or displacement."""
    record = campaign.with_role("fit")[0]
    silent = campaign.with_role("noise")
    hum = tuple(mains_effects()) if silent and hum_line(silent[0].sense_v, record.sample_rate_hz) else ()
    if record.drive_v.shape[1] == record.sense_v.shape[1] == 2:
        gyro = NIGHTLY_MODEL if campaign.frame.updown else SCREENING_MODEL
        return (replace(gyro, effects=gyro.effects + hum),)
    return (Model(PlantSpec("modal", 1, "velocity"), hum), Model(PlantSpec("modal", 1, "displacement"), hum))


def _general_columns(
    campaign: Campaign, model: Model | None, settings: IdentificationSettings, gate: Gate
) -> dict[str, Any]:
    noise = noise_level(campaign)
    candidates = default_models(campaign) if model is None else (model,)
    fits = [fit_campaign(candidate, campaign, noise) for candidate in candidates]
    fit = min(fits, key=lambda fit: (not fit.fit_ok, fit.chi2))
    status, reason = campaign_status(fit, campaign, gate, (settings.low_hz, settings.high_hz))
    estimates = dict(fit.parameters)
    if fit.split_hz is not None:
        estimates["split_hz"] = fit.split_hz
    return {
        "status": status,
        "status_reason": reason,
        **normal_intervals(with_common_errors(estimates, campaign.systematic)),
        "model": fit.model.to_toml().splitlines()[0],
        "noise_from": noise.source,
        "error": fit.error["fit"] if noise.independent else None,
        "relative_error": fit.relative_error["fit"],
        "relative_error_validate": fit.relative_error["validate"],
        "chi2_per_dof": fit.chi2 / fit.dof,
    }
