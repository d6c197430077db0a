"""Maximum likelihood of a model on a campaign, full band, in the time domain.

    x^ = argmin  sum_records |P (y - f(x)) / sigma|^2 + priors,        covariance = (J^T J)^-1

P projects out what is free in every record and channel: the offset, the lines of mains_hum where it is in the model,
and the filter's transient where a record does not start at rest; the mechanics' initial state is then fitted too.
Held-out records are only judged: their own nuisances are refitted and counted.

Gauss-Newton with Levenberg's damping in the model's smooth coordinates.  The residual is always exact; the plant's
columns of J leave nonlinear effects out while those are weak (the step then contracts at their relative strength).

Shapes: N samples, S senses, P free parameters, L nuisances a channel.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ...arrays import FloatArray
from ...device.model import Model
from ...device.plant import C12
from ...errors import ConfigError, MeasurementError
from ...experiment.noise.level import NoiseLevel
from ...experiment.record import Campaign, Record, Role
from ...threads import mapped
from .free_disturbances import free_shapes
from .gauss_newton import CLOSE, FAINT, Sensitivity, covariance_of, descend, point_at
from .residuals import CampaignResiduals, Task, Tasks
from .scan import scan
from .starts import find_start

Estimate = tuple[float, float]


@dataclass(frozen=True, eq=False)
class RecordFit:
    """One record as the fitted model explains it.

    predicted_v (N, S) [V] without nuisances; residual (N, S) in sigmas, nuisances taken out; dof = N S less nuisances;
    error = sqrt(chi2 / dof); relative_error = rms of residual volts over rms of the measured; misfit = sqrt(error^2 -
    1).
    start (2n,): fitted initial state, ``None`` where the record starts at rest.
    """

    name: str
    role: Role | None
    predicted_v: FloatArray
    residual: FloatArray
    chi2: float
    dof: int
    error: float
    relative_error: float
    misfit: float
    start: FloatArray | None


@dataclass(frozen=True, eq=False)
class CampaignFit:
    """A model fitted to the fit records of a campaign, judged on all driven records.

    parameters : name -> (value, sd); the sd of what is fixed is 0.
    names, covariance : the free parameters and their covariance (P, P).
    x, x_covariance : the same in smooth coordinates.
    records : one a driven record, in the campaign's order.
    chi2, dof : of the fit records; dof counts nuisances and parameters.
    error, relative_error, misfit : pooled by role, "fit" and "validate" (``None`` without such records).
    converged : the fit stands still inside the ranges.
    fit_ok : and the data determine every free parameter.
    theta_deg, split_hz : with sd, for plant "gyro".
    """

    model: Model
    parameters: dict[str, Estimate]
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
    theta_deg: Estimate | None
    split_hz: Estimate | None

    @property
    def values(self) -> dict[str, float]:
        """Parameter values by name, as ``forward`` takes them."""
        return {name: value for name, (value, _) in self.parameters.items()}

    @property
    def error_v(self) -> dict[str, float]:
        """rms of (measured - model) [V] in every record, over its samples and channels."""
        return {r.name: float(np.sqrt(np.mean((r.residual * self.noise.sigma_v) ** 2))) for r in self.records}

    def of_role(self, role: Role) -> tuple[RecordFit, ...]:
        """The records of one role."""
        return tuple(record for record in self.records if record.role == role)


def _held_out(problem: CampaignResiduals, values: Mapping[str, float], task: Task) -> RecordFit:
    """A record that was not fitted, as the model explains it; its unknown initial state is refitted."""
    alone, start = Tasks((task,), (((0,), task.group),)), None
    if task.coordinates:
        start = np.zeros(2 * task.coordinates)
        f = problem.start_columns(values, task, start, problem.strength(values, task) > FAINT)
        solve = np.linalg.pinv(f.T @ f, rcond=1e-12, hermitian=True) @ f.T
        for _ in range(6):
            step = solve @ problem.residuals(values, alone, [start])[0].reshape(-1)
            start = start + step
            if float(np.sum((f @ step) ** 2)) < CLOSE:
                break
    (predicted,) = problem.predictions(values, alone, [start])
    return _judge(problem, task, start, predicted)


def _judge(problem: CampaignResiduals, task: Task, start: FloatArray | None, predicted: FloatArray) -> RecordFit:
    """What a prediction (N, S) of a record is worth."""
    record = task.record
    lost = task.basis.shape[1] * record.sense_v.shape[1] + 2 * task.coordinates
    residual = problem.whiten(record.sense_v - predicted, task)
    chi2, dof = float(np.vdot(residual, residual)), residual.size - lost
    error = float(np.sqrt(chi2 / dof))
    level = float(np.sqrt(np.mean(record.sense_v**2)))
    relative = float(np.sqrt(np.mean((residual * problem.sigma_v) ** 2))) / max(level, 1e-300)
    misfit = float(np.sqrt(max(error**2 - 1.0, 0.0)))
    return RecordFit(record.name, record.role, predicted, residual, chi2, dof, error, relative, misfit, start)


def _pooled(
    records: tuple[RecordFit, ...], campaign: Campaign, sigma_v: FloatArray, parameters: int
) -> tuple[float, float]:
    chi2 = sum(record.chi2 for record in records)
    dof = sum(record.dof for record in records) - parameters
    rest = sum(float(np.sum((record.residual * sigma_v) ** 2)) for record in records)
    names = {record.name for record in records}
    total = sum(float(np.sum(record.sense_v**2)) for record in campaign.records if record.name in names)
    return float(np.sqrt(chi2 / dof)), float(np.sqrt(rest / max(total, 1e-300)))


def _scanned(
    model: Model,
    effect: str,
    campaign: Campaign,
    sigma_v: FloatArray,
    begun: Mapping[str, float],
    likely: Mapping[str, tuple[float, ...]],
    threads: int,
) -> dict[str, float]:
    """Start values of an effect whose parameters do not all exist at its null, from where the model without it stands."""
    smaller = model.without_effect(effect)
    problem = CampaignResiduals(smaller, campaign, sigma_v, threads)
    values = smaller.complete({name: value for name, value in begun.items() if name in smaller.by_name})
    tasks = problem.tasks(campaign.with_role("fit"), values)
    rest, shape = (None,) * len(tasks.each), model.built.shape
    steps = problem.steps(values, tasks.each[0], None)
    return scan(
        smaller,
        effect,
        values,
        tasks,
        campaign.instrument,
        problem.residuals(values, tasks, rest),
        problem.columns(values, tasks, rest, False, steps),
        [partial(problem.whiten, task=task) for task in tasks.each],
        {m.name: likely.get(model.effect(effect).full_name(m), ()) for m in model.effect(effect).members(shape)},
    )


def _shaped(
    model: Model, effect: str, campaign: Campaign, sigma_v: FloatArray, begun: Mapping[str, float]
) -> dict[str, float]:
    """The shape of a disturbance (mains frequency, harmonics) that the residuals without it show best."""
    smaller = model.without_effect(effect)
    problem = CampaignResiduals(smaller, campaign, sigma_v)
    values = smaller.complete({name: value for name, value in begun.items() if name in smaller.by_name})
    tasks = problem.tasks(campaign.with_role("fit"), values)
    residuals = problem.residuals(values, tasks, (None,) * len(tasks.each))
    found = model.effect(effect)
    rates = [task.record.sample_rate_hz for task in tasks.each]
    best = max(free_shapes(found, model.built.shape, residuals, rates), key=lambda shape: shape.worth)
    return {found.full_name(m): best.point[m.name] for m in found.members(model.built.shape)}


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
) -> tuple[CampaignFit, list[Sensitivity]]:
    """Fit ``model`` to the records with role "fit" and judge it on those and the held-out ones.

    With the fit come the columns, in sigmas, that smooth coordinates and initial states move in each fit record.

    Parameters
    ----------
    model : plant and effects; a modal plant takes its numbers of channels from the records.
    campaign : at least one driven record with role "fit".
    noise : sigma of each channel.
    start : parameter values to start from (other names are ignored); what is missing is found from the records
        (plant) or starts at its null (effects), or where a scan finds it best (parameters that do not exist there).
    likely : parameter -> values that such a scan tries.
    threads : how many records are integrated at once.

    Raises
    ------
    MeasurementError : no record to fit, or channels that the plant does not have.
    ConfigError : a start that no device can have.
    """
    fitted = campaign.with_role("fit")
    if not fitted:
        raise MeasurementError("no record to fit", next_step='give a record role = "fit"')
    first = fitted[0]
    model = model.with_channels(first.sense_v.shape[1], first.drive_v.shape[1])
    sigma_v = noise.sigma_v
    begun = {name: float(value) for name, value in (start or {}).items() if name in model.by_name}
    if any(p.name not in begun and p.name not in model.fixed for p in model.built.parameters):
        begun = {**find_start(model, fitted, campaign.instrument, sigma_v), **begun}
    begun = {**begun, **model.fixed}
    for effect in model.ordered_effects():
        members = [m for m in effect.members(model.built.shape) if m.fitted]
        if any(m.grid for m in members) and not any(effect.full_name(m) in begun for m in members):
            begun |= _scanned(model, effect.name, campaign, sigma_v, begun, likely or {}, threads)
    for effect in model.ordered_effects():
        shape = {effect.full_name(m) for m in effect.members(model.built.shape) if not m.fitted}
        if effect.disturbance is not None and not shape <= begun.keys():
            begun = _shaped(model, effect.name, campaign, sigma_v, begun) | begun
        # What is not fitted stays as it was found.
        model = replace(model, fixed={**model.fixed, **{name: begun[name] for name in shape if name in begun}})
    problem = CampaignResiduals(model, campaign, sigma_v, threads)
    values = model.complete(begun)
    tasks = problem.tasks(fitted, values)
    starts = tuple(np.zeros(2 * task.coordinates) if task.coordinates else None for task in tasks.each)
    at = point_at(problem, model.to_internal(values), tasks, starts)
    if at is None and C12 in values:
        values = model.complete({**begun, C12: 0.0})
        at = point_at(problem, model.to_internal(values), tasks, starts)
    if at is None:
        raise ConfigError(
            "the fit cannot start here: no such device", value=values, next_step="give other start values"
        )
    dof = sum(r.size for r in at.residuals) - at.x.size
    stand = descend(problem, at, tasks, dof)
    at, normal, converged = stand.at, stand.normal, stand.converged
    x_covariance, determined = covariance_of(normal)
    values = model.to_values(at.x)
    covariance = model.covariance_of_values(at.x, x_covariance)
    # What leaves no trace in the fit records is not known at all.
    unknown = np.where(np.diagonal(normal) > 0.0, 0.0, np.inf)
    sd = dict(zip(model.free, (np.sqrt(np.maximum(np.diagonal(covariance), 0.0)) + unknown).tolist()))
    judged = {
        id(task.record): _judge(problem, task, s, predicted)
        for task, s, predicted in zip(tasks.each, at.starts, at.predicted)
    }
    alone = CampaignResiduals(model, campaign, sigma_v)

    def seen(record: Record) -> RecordFit:
        return judged.get(id(record)) or _held_out(alone, values, alone.task(record, values))

    records = tuple(mapped(seen, (r for r in campaign.records if r.role in ("fit", "validate")), threads))
    error: dict[str, float | None] = {}
    relative: dict[str, float | None] = {}
    misfit: dict[str, float | None] = {}
    for role, spent in (("fit", at.x.size), ("validate", 0)):
        chosen = tuple(record for record in records if record.role == role)
        if chosen:
            e, rel = _pooled(chosen, campaign, sigma_v, spent)
            error[role], relative[role], misfit[role] = e, rel, float(np.sqrt(max(e**2 - 1.0, 0.0)))
        else:
            error[role] = relative[role] = misfit[role] = None
    fit_records = tuple(record for record in records if record.role == "fit")
    theta = split = None
    if model.plant.kind == "gyro":
        theta = (values["theta_deg"], sd.get("theta_deg", 0.0))
        i = [model.free.index(n) if n in model.free else -1 for n in ("f1_hz", "f2_hz")]
        turn = np.zeros(len(model.free))
        for k, sign in zip(i, (-1.0, 1.0)):
            if k >= 0:
                turn[k] = sign
        split = (values["f2_hz"] - values["f1_hz"], float(np.sqrt(max(float(turn @ covariance @ turn), 0.0))))
    found = CampaignFit(
        model,
        {name: (value, sd.get(name, 0.0)) for name, value in values.items()},
        model.free,
        covariance,
        at.x,
        x_covariance,
        records,
        noise,
        sum(record.chi2 for record in fit_records),
        sum(record.dof for record in fit_records) - at.x.size,
        error,
        relative,
        misfit,
        converged,
        bool(converged and determined),
        theta,
        split,
    )
    return found, stand.sensitivities
