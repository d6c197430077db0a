"""Maximum likelihood of a model on a campaign, full band, in the time domain.

    x^ = argmin  sum_records |P (y - f(x)) / sigma|^2 + priors,        covariance = (J^T J)^-1

P projects out what is free in every record and channel: the offset, the lines of mains_hum where it is in the model, and the
transient of the filter where a record does not start at rest; the initial state of the mechanics is then fitted too.  Held-out
records are predicted with the fitted parameters; only their own nuisances are refitted, and counted.

Shapes: N samples, S senses, P free parameters, L nuisances per channel.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ...arrays import FloatArray
from ...device.model import Model
from ...device.plant import C12
from ...errors import ConfigError, MeasurementError
from ...experiment.noise.level import NoiseLevel
from ...experiment.record import Campaign, Record, Role
from ...threads import mapped
from .continuation import continued, restarted
from .effect_starts import scanned_effects, with_effect_starts
from .free_states import free_start
from .gauss_newton import GaussNewtonResult, minimise
from .linear_step import FitPoint, Sensitivity, covariance_of, point_at
from .record_fit import RecordFit, held_out_fit, misfit_of, pooled_errors, record_fit
from .residuals import CampaignResiduals, Tasks
from .scales import scaled_to
from .starts import find_start

ValueAndSd = tuple[float, float]


@dataclass(frozen=True, eq=False)
class CampaignFit:
    """A model fitted to the fit records of a campaign, and all driven records against it.

    Parameters
    ----------
    model : with channels, and the shapes of disturbances fixed.
    parameters : name -> (value, sd); the sd of a fixed parameter is 0.
    names, covariance : the free parameters and their covariance (P, P).
    x, x_covariance : the same in smooth coordinates, (P,) and (P, P).
    records : every driven record, in the order of the campaign.
    noise : the noise level that scales the residuals.
    chi2, dof : of the fit records; dof counts nuisances and parameters.
    error, relative_error, misfit : pooled by role, "fit" and "validate" (``None`` without such records).
    converged : the fit converged inside the ranges.
    fit_ok : it converged, and the data determine every free parameter.
    theta_deg, split_hz : (value, sd) for plant "gyro", else ``None``.
    """

    model: Model
    parameters: dict[str, ValueAndSd]
    names: tuple[str, ...]
    covariance: FloatArray
    x: FloatArray
    x_covariance: FloatArray
    records: tuple[RecordFit, ...]
    noise: NoiseLevel
    chi2: float
    dof: int
    error: dict[str, float | None]
    relative_error: dict[str, float | None]
    misfit: dict[str, float | None]
    converged: bool
    fit_ok: bool
    theta_deg: ValueAndSd | None
    split_hz: ValueAndSd | None

    @property
    def values(self) -> dict[str, float]:
        """Parameter values by name, as ``forward`` takes them."""
        return {name: value for name, (value, _) in self.parameters.items()}

    @property
    def error_v(self) -> dict[str, float]:
        """rms of (measured - model) [V] of every record, over its samples and channels."""
        return {r.name: float(np.sqrt(np.mean(r.rms_v**2))) for r in self.records}

    def of_role(self, role: Role) -> tuple[RecordFit, ...]:
        """The records of one role."""
        return tuple(record for record in self.records if record.role == role)


def fit_campaign(
    model: Model,
    campaign: Campaign,
    noise: NoiseLevel,
    start: Mapping[str, float] | None = None,
    likely: Mapping[str, tuple[float, ...]] | None = None,
    threads: int = 1,
) -> CampaignFit:
    """``fit_with_columns`` without the columns."""
    return fit_with_columns(model, campaign, noise, start, likely, threads)[0]


def fit_with_columns(
    model: Model,
    campaign: Campaign,
    noise: NoiseLevel,
    start: Mapping[str, float] | None = None,
    likely: Mapping[str, tuple[float, ...]] | None = None,
    threads: int = 1,
) -> tuple[CampaignFit, Sequence[Sensitivity]]:
    """Fit ``model`` to the records with role "fit"; compare those and the held-out records with it.

    The second result are the columns of the Jacobian, in sigmas, for each fit record: with respect to the smooth coordinates
    and to the initial state.

    Parameters
    ----------
    model : plant and effects; a modal plant takes its numbers of channels from the records.
    campaign : at least one driven record with role "fit".
    noise : sigma of each channel.
    start : parameter values to start from; other names are ignored.  Missing plant parameters are found from the records,
        those of effects start at their null, or at the best point of a scan where they do not exist at the null.
    likely : parameter -> values that such a scan tries.
    threads : how many records are integrated at once.

    Raises
    ------
    MeasurementError : no record to fit, or channels that the plant does not have.
    ConfigError : start values that no device can have.
    """
    fitted = campaign.with_role("fit")
    if not fitted:
        raise MeasurementError("no record to fit", next_step='give a record role = "fit"')
    first, sigma_v = fitted[0], noise.sigma_v
    model = scaled_to(model.with_channels(first.sense_v.shape[1], first.drive_v.shape[1]), campaign)
    known = {name: float(value) for name, value in (start or {}).items() if name in model.by_name}
    if any(p.name not in known and p.name not in model.fixed for p in model.built.parameters):
        known = {**find_start(model, fitted, campaign.instrument, sigma_v), **known}
    if start is None:
        known = known | _fitted_without_scanned(model, campaign, noise, known, threads)
    model, known = with_effect_starts(model, campaign, noise, {**known, **model.fixed}, likely or {}, threads)
    problem = CampaignResiduals(model, campaign, noise, threads)
    tasks = problem.tasks(fitted, model.complete(known))
    at = _first_point(problem, tasks, known)
    dof = sum(r.size for r in at.residuals) - at.x.size
    result = minimise(problem, at, tasks, dof)
    result = continued(problem, at, result, tasks, dof, noise.known)
    result = restarted(problem, result, tasks, dof)
    return campaign_fit(problem, campaign, noise, tasks, result), result.sensitivities


def _fitted_without_scanned(
    model: Model, campaign: Campaign, noise: NoiseLevel, known: Mapping[str, float], threads: int
) -> dict[str, float]:
    """Values of a fit without the effects that are scanned; empty if the model has no others or nothing is scanned.

    A scan explains what the others leave.  With a hardening spring at its null there is nothing but that spring to explain, so
    that the scan of a hidden mode ends at no coupling, from where its frequency does not change the record.
    """
    smaller, scanned = model, scanned_effects(model, {**known, **model.fixed})
    for name in scanned:
        smaller = smaller.without_effect(name)
    if not scanned or not smaller.effects:
        return {}
    return fit_campaign(smaller, campaign, noise, dict(known), threads=threads).values


def _first_point(problem: CampaignResiduals, tasks: Tasks, known: Mapping[str, float]) -> FitPoint:
    """The start of the fit, without off-diagonal damping where no device can have the given one."""
    model = problem.model
    values = model.complete(known)
    starts = tuple(free_start(problem, values, task) for task in tasks.each)
    at = point_at(problem, model.to_internal(values), tasks, starts)
    if at is None and C12 in values:
        values = model.complete({**known, C12: 0.0})
        at = point_at(problem, model.to_internal(values), tasks, starts)
    if at is None:
        raise ConfigError(
            "no device can have the start values of the fit", value=values, next_step="give other start values"
        )
    return at


def campaign_fit(
    problem: CampaignResiduals, campaign: Campaign, noise: NoiseLevel, tasks: Tasks, result: GaussNewtonResult
) -> CampaignFit:
    """The end ``result`` of a fit of ``tasks`` as parameters, errors and all driven records beside the model."""
    model, at = problem.model, result.at
    x_covariance, determined = covariance_of(result.normal)
    if not noise.known:
        # Nothing measures the noise: the residual scales the sds, as if it were white.
        x_covariance = x_covariance * (at.chi2 / max(sum(r.size for r in at.residuals) - at.x.size, 1))
    values = model.to_values(at.x)
    covariance = model.covariance_of_values(at.x, x_covariance)
    # A parameter that does not change the fit records at all is unknown.
    unknown = np.where(np.diagonal(result.normal) > 0.0, 0.0, np.inf)
    sd = dict(zip(model.free, (np.sqrt(np.maximum(np.diagonal(covariance), 0.0)) + unknown).tolist()))
    compared = {
        id(task.record): record_fit(problem, task, s, predicted_v)
        for task, s, predicted_v in zip(tasks.each, at.starts, at.predicted)
    }
    alone = CampaignResiduals(model, campaign, noise)

    def record_of(record: Record) -> RecordFit:
        return compared.get(id(record)) or held_out_fit(alone, values, alone.task(record, values))

    driven = (r for r in campaign.records if r.role in ("fit", "validate"))
    records = tuple(mapped(record_of, driven, problem.threads))
    error: dict[str, float | None] = {}
    relative: dict[str, float | None] = {}
    misfit: dict[str, float | None] = {}
    for role, parameters in (("fit", at.x.size), ("validate", 0)):
        chosen = tuple(record for record in records if record.role == role)
        if chosen:
            e, relative[role] = pooled_errors(chosen, campaign, parameters)
            error[role], misfit[role] = e, misfit_of(e)
        else:
            error[role] = relative[role] = misfit[role] = None
    fit_records = tuple(record for record in records if record.role == "fit")
    return CampaignFit(
        model=model,
        parameters={name: (value, sd.get(name, 0.0)) for name, value in values.items()},
        names=model.free,
        covariance=covariance,
        x=at.x,
        x_covariance=x_covariance,
        records=records,
        noise=noise,
        chi2=sum(record.chi2 for record in fit_records),
        dof=sum(record.dof for record in fit_records) - at.x.size,
        error=error,
        relative_error=relative,
        misfit=misfit,
        converged=result.converged,
        fit_ok=bool(result.converged and determined and np.all(np.isfinite(covariance))),
        theta_deg=(values["theta_deg"], sd.get("theta_deg", 0.0)) if model.plant.kind == "gyro" else None,
        split_hz=_split_hz(model, values, covariance) if model.plant.kind == "gyro" else None,
    )


def _split_hz(model: Model, values: Mapping[str, float], covariance: FloatArray) -> ValueAndSd:
    """f2 - f1 and its sd [Hz] from the covariance (P, P) of the free parameters."""
    slope = np.zeros(len(model.free))
    for name, sign in (("f1_hz", -1.0), ("f2_hz", 1.0)):
        if name in model.free:
            slope[model.free.index(name)] = sign
    return values["f2_hz"] - values["f1_hz"], float(np.sqrt(max(float(slope @ covariance @ slope), 0.0)))
