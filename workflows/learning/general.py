"""Identify a campaign with the general fit: any plant, any drives and senses, any initial state.

For campaigns outside the in-band path (one drive and one sense, records that do not start at rest, a band-limited hold) or
with a model file.  Intervals are normal: value +- 1.645 sd.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from scipy.stats import norm

from pipeline.device.model import Model, PlantSpec, load_model
from pipeline.experiment.noise.level import noise_level
from pipeline.experiment.noise.lines import hum_line
from pipeline.experiment.record import Campaign
from pipeline.inference.gate import Gate
from pipeline.inference.general.fit import CampaignFit, fit_campaign
from pipeline.inference.screening.campaign import reference_comparison

_HALF = float(norm.ppf(0.95))
_SCREENING = ("offdiagonal_damping",)


def models_for(campaign: Campaign) -> tuple[Model, ...]:
    """Models to try without a model file: the screening gyro for 2 x 2, else one mode seen as velocity or displacement."""
    record = campaign.with_role("fit")[0]
    silent = campaign.with_role("noise")
    hum = ("mains_hum",) if silent and hum_line(silent[0].sense_v, record.sample_rate_hz) else ()
    if record.drive_v.shape[1] == record.sense_v.shape[1] == 2:
        return (Model(effects=_SCREENING + hum),)
    kinds = ("velocity", "displacement")
    return tuple(Model(PlantSpec("modal", 1, kind), hum) for kind in kinds)  # type: ignore[arg-type]


def best_fit(campaign: Campaign, model: Path | None) -> CampaignFit:
    """The fit of the model file, or the best of :func:`models_for`."""
    candidates = (load_model(model),) if model is not None else models_for(campaign)
    noise = noise_level(campaign)
    fits = [fit_campaign(candidate, campaign, noise) for candidate in candidates]
    return min(fits, key=lambda fit: (not fit.fit_ok, fit.chi2))


def identify_general(campaign: Campaign, model: Path | None) -> tuple[dict[str, Any], dict[str, dict[str, float]]]:
    """Columns of a campaign, and its reference values against them.

    Raises
    ------
    MeasurementError : nothing to fit.
    ConfigError : the model file cannot be used.
    """
    if not campaign.with_role("fit"):
        campaign = replace(campaign, records=tuple(replace(r, role="fit") for r in campaign.records))
    fit = best_fit(campaign, model)
    error = fit.error["fit"] if fit.noise.source != "local" else None
    status, reason = "ok", None
    if not fit.fit_ok:
        status, reason = "fit_failed", "the fit did not converge, or the records do not determine every parameter"
    elif error is not None and error > Gate().error_max:
        status = "misfit"
        reason = f"error {error:.4g} above {Gate().error_max:g}: the model does not explain the records"
    estimates = dict(fit.parameters)
    if fit.split_hz is not None:
        estimates["split_hz"] = fit.split_hz
    columns: dict[str, Any] = {"device_id": campaign.device_id, "status": status, "status_reason": reason}
    for name, (value, sd) in estimates.items():
        columns |= {name: value, f"{name}_sd": sd, f"{name}_q05": value - _HALF * sd, f"{name}_q95": value + _HALF * sd}
    columns |= {
        "model": fit.model.to_toml().splitlines()[0],
        "noise_from": fit.noise.source,
        "error": error,
        "relative_error": fit.relative_error["fit"],
        "relative_error_validate": fit.relative_error["validate"],
        "chi2_per_dof": fit.chi2 / fit.dof,
    }
    return columns, reference_comparison(campaign, columns)
