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
from dataclasses import dataclass

import numpy as np

from ..arrays import BoolArray, FloatArray
from ..device.model import Model
from ..device.plant import C12
from ..errors import ConfigError, MeasurementError
from ..experiment.antialias import filter_poles
from ..experiment.instrument import Instrument
from ..experiment.linear import clock_of, free_response
from ..experiment.noise_level import NoiseLevel
from ..experiment.record import Campaign, Record, Role
from ..experiment.response import converted, linear_volts, remainder_volts, volts
from ..experiment.sensitivity import jacobian, tuned_steps
from ..experiment.system import System, assemble, conditions_of
from .campaign_start import find_start

_ITERATIONS = 40
#: Expected fall of chi2 (in units of chi2/dof, at least 1) at which the fit stands still: a hundredth of a sd.
_STANDSTILL = 1e-4
#: The same where a trial does not fall any more: rounding and inexact columns, a tenth of a sd.
_CLOSE = 1e-2
#: Expected fall of chi2 below which the columns of the step before, updated, still serve.
_SMALL_STEP = 3e3
#: Share of the record made by forces and pick-off laws from which the plant's columns are computed with them.
_STRONG = 0.1
#: And below which they always suffice without.
_FAINT = 1e-3

Estimate = tuple[float, float]
#: Inverse normal matrix of an initial state, its cross terms with x, its slope.
_Back = tuple[FloatArray, FloatArray, FloatArray]


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
    fit_ok : the fit converged inside the ranges, and the data determine every free parameter.
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
    fit_ok: bool
    theta_deg: Estimate | None
    split_hz: Estimate | None

    @property
    def values(self) -> dict[str, float]:
        """Parameter values by name, as ``forward`` takes them."""
        return {name: value for name, (value, _) in self.parameters.items()}

    def of_role(self, role: Role) -> tuple[RecordFit, ...]:
        """The records of one role."""
        return tuple(record for record in self.records if record.role == role)


def nuisance_columns(model: Model, values: Mapping[str, float], record: Record, instrument: Instrument) -> FloatArray:
    """Orthonormal basis (N, L) of what is free in every channel of ``record``: offset, lines, the filter transient."""
    samples = record.drive_v.shape[0]
    t = np.arange(samples) / record.sample_rate_hz
    columns = [np.ones((samples, 1))]
    complete = model.complete(values)
    system = assemble(model, complete, instrument, conditions_of(record, instrument, None))
    for effect in model.ordered_effects():
        if effect.disturbance is not None:
            p = np.array([complete[effect.full_name(m)] for m in effect.members(model.built.shape)])
            columns.append(effect.disturbance(t, p, system.context))
    if not record.at_rest and instrument.antialias is not None:
        q, _ = filter_poles(instrument.antialias)
        decay = np.exp(np.outer(t, q[q.imag >= 0.0]))
        columns.append(np.concatenate([decay.real, decay.imag], axis=1))
    stacked = np.concatenate(columns, axis=1)
    scaled = stacked / np.linalg.norm(stacked, axis=0)
    gram = scaled.T @ scaled
    if np.max(np.abs(gram - np.eye(gram.shape[0]))) < 1e-12:
        return np.asarray(scaled)
    values_, vectors = np.linalg.eigh(gram)
    keep = values_ > 1e-10 * values_[-1]
    return np.asarray(scaled @ (vectors[:, keep] / np.sqrt(values_[keep])))


@dataclass(frozen=True, eq=False)
class _Task:
    """A record to explain: its nuisance basis, and how many coordinates have a free initial state (0: at rest)."""

    record: Record
    basis: FloatArray
    coordinates: int


class _Problem:
    """Residuals and normal equations of a set of records; holds no state but what it was made of."""

    def __init__(self, model: Model, campaign: Campaign, sigma_v: FloatArray) -> None:
        self.model, self.instrument, self.angular_gain = model, campaign.instrument, campaign.angular_gain
        self.sigma_v = sigma_v

    def task(self, record: Record, values: Mapping[str, float]) -> _Task:
        coordinates = 0 if record.at_rest else self.model.built.sense_motion().shape[1]
        return _Task(record, nuisance_columns(self.model, values, record, self.instrument), coordinates)

    def system(self, values: Mapping[str, float], record: Record) -> System:
        return assemble(self.model, values, self.instrument, conditions_of(record, self.instrument, self.angular_gain))

    def full_start(self, system: System, task: _Task, start: FloatArray | None) -> FloatArray | None:
        """Initial state of all coordinates: those that effects append start at rest."""
        if start is None:
            return None
        n, own = system.mechanics.stiffness.shape[1], task.coordinates
        full = np.zeros(2 * n)
        full[:own], full[n : n + own] = start[:own], start[own:]
        return full

    def predict(self, values: Mapping[str, float], task: _Task, start: FloatArray | None) -> FloatArray:
        system = self.system(values, task.record)
        clock = clock_of(task.record.sample_rate_hz, self.instrument.hold)
        return converted(system, volts(system, task.record.drive_v, clock, self.full_start(system, task, start)))

    def whiten(self, y: FloatArray, task: _Task) -> FloatArray:
        """P y / sigma, y (N, S) or (N, S, k)."""
        flat = y.reshape(y.shape[0], -1)
        rest = (flat - task.basis @ (task.basis.T @ flat)).reshape(y.shape)
        return rest / (self.sigma_v if y.ndim == 2 else self.sigma_v[:, None])

    def residual(self, values: Mapping[str, float], task: _Task, start: FloatArray | None) -> FloatArray:
        return self.whiten(task.record.sense_v - self.predict(values, task, start), task)

    def start_columns(
        self, values: Mapping[str, float], task: _Task, start: FloatArray | None, exact: bool
    ) -> FloatArray:
        """(N S, 2 n): what the initial state moves, in sigmas; ``exact`` with what nonlinear effects make of it."""
        system = self.system(values, task.record)
        clock = clock_of(task.record.sample_rate_hz, self.instrument.hold)
        m = system.mechanics
        n, own = m.stiffness.shape[1], task.coordinates
        samples = task.record.drive_v.shape[0]
        columns = free_response(m, system.readout, samples * clock.stride, clock)[:: clock.stride]
        chosen = [*range(own), *range(n, n + own)]
        columns = columns[:, :, chosen]
        full = self.full_start(system, task, start)
        if exact and full is not None:
            v = task.record.drive_v
            before = remainder_volts(system, v, clock, full)
            omega = np.sqrt(np.diagonal(m.stiffness[0]))
            seen = np.max(np.abs(m.position_sense[0]) + omega * np.abs(m.velocity_sense[0]), axis=0)
            motion = 1e-4 * float(np.sqrt(np.mean(task.record.sense_v**2))) / seen
            steps = np.concatenate([motion, motion * omega])
            for column, i in enumerate(chosen):
                moved = full.copy()
                moved[i] += steps[i]
                columns[:, :, column] += (remainder_volts(system, v, clock, moved) - before) / steps[i]
        return self.whiten(columns, task).reshape(-1, 2 * own)

    def steps(self, values: Mapping[str, float], task: _Task, start: FloatArray | None) -> FloatArray:
        """Steps (P,) of the differences, as ``task`` asks for them."""
        full = self.full_start(self.system(values, task.record), task, start)
        return tuned_steps(self.model, values, task.record, self.instrument, angular_gain=self.angular_gain, start=full)

    def columns(
        self, values: Mapping[str, float], task: _Task, start: FloatArray | None, exact: bool, steps: FloatArray
    ) -> FloatArray:
        """(N S, P): what the free parameters move, in sigmas."""
        system = self.system(values, task.record)
        full = self.full_start(system, task, start)
        found = jacobian(
            self.model,
            values,
            task.record,
            self.instrument,
            angular_gain=self.angular_gain,
            start=full,
            exact=exact,
            steps=steps,
        )
        return self.whiten(found, task).reshape(-1, found.shape[-1])

    def strength(self, values: Mapping[str, float], task: _Task) -> float:
        """Share of the record that forces and pick-off laws make."""
        system = self.system(values, task.record)
        if not (system.forces or system.senses):
            return 0.0
        clock = clock_of(task.record.sample_rate_hz, self.instrument.hold)
        linear = linear_volts(system, task.record.drive_v, clock)
        rest = volts(system, task.record.drive_v, clock) - linear
        return float(np.linalg.norm(rest) / max(np.linalg.norm(linear), 1e-300))


@dataclass(frozen=True, eq=False)
class _Point:
    """Where the fit stands: smooth coordinates, initial states by record, residuals, chi2 with priors."""

    x: FloatArray
    starts: tuple[FloatArray | None, ...]
    residuals: tuple[FloatArray, ...]
    chi2: float


def _prior_rows(model: Model, values: Mapping[str, float]) -> FloatArray:
    """(value - mean)/sd of each free parameter with a normal prior, 0 elsewhere, (P,); and 1/sd in the second row."""
    rows = np.zeros((2, len(model.free)))
    for i, name in enumerate(model.free):
        kind, mean, sd = model.prior_of(name)
        if kind == "normal":
            rows[:, i] = (values[name] - mean) / sd, 1.0 / sd
    return rows


def _point(
    problem: _Problem,
    x: FloatArray,
    tasks: tuple[_Task, ...],
    starts: tuple[FloatArray | None, ...],
    most: float = np.inf,
) -> _Point | None:
    """The point at ``x``, or ``None`` where no device can be or chi2 exceeds ``most``."""
    try:
        values = problem.model.to_values(x)
        if not problem.model.allowed(values):
            return None
        chi2 = float(np.sum(_prior_rows(problem.model, values)[0] ** 2))
        residuals: list[FloatArray] = []
        for task, start in zip(tasks, starts):
            residuals.append(problem.residual(values, task, start))
            chi2 += float(np.vdot(residuals[-1], residuals[-1]))
            if not (np.isfinite(chi2) and chi2 <= most):
                return None
    except (ConfigError, np.linalg.LinAlgError):
        return None
    return _Point(x, starts, tuple(residuals), chi2)


_Sensitivity = tuple[FloatArray, FloatArray | None]


def _sensitivities(
    problem: _Problem, at: _Point, tasks: tuple[_Task, ...], exact: bool, steps: FloatArray
) -> list[_Sensitivity]:
    """Columns of x (N S, P) and of the initial state (N S, 2 n) of each record, in sigmas."""
    values = problem.model.to_values(at.x)
    return [
        (
            problem.columns(values, task, start, exact, steps),
            None if start is None else problem.start_columns(values, task, start, exact),
        )
        for task, start in zip(tasks, at.starts)
    ]


def _equations(
    problem: _Problem, at: _Point, sensitivities: list[_Sensitivity]
) -> tuple[FloatArray, FloatArray, list[_Back | None]]:
    """Normal matrix (P, P) and slope (P,), initial states eliminated; what recovers those, record by record."""
    size = at.x.size
    normal, slope = np.zeros((size, size)), np.zeros(size)
    back: list[_Back | None] = []
    for (j, f), residual in zip(sensitivities, at.residuals):
        r = residual.reshape(-1)
        normal += j.T @ j
        slope += j.T @ r
        if f is None:
            back.append(None)
            continue
        inverse: FloatArray = np.linalg.pinv(f.T @ f, rcond=1e-12, hermitian=True).astype(np.float64)
        cross, own = f.T @ j, f.T @ r
        normal -= cross.T @ inverse @ cross
        slope -= cross.T @ inverse @ own
        back.append((inverse, cross, own))
    rows = _prior_rows(problem.model, problem.model.to_values(at.x))
    if np.any(rows[1]):
        turned = rows[1][:, None] * problem.model.turn(at.x)
        normal += turned.T @ turned
        slope -= turned.T @ rows[0]
    return normal, slope, back


def _updated(
    sensitivities: list[_Sensitivity], before: _Point, after: _Point, weight: FloatArray
) -> list[_Sensitivity]:
    """Broyden's update: the columns of x put right along the step just made, at no cost."""
    step = after.x - before.x
    along = weight * step
    length = float(along @ step)
    if length == 0.0:
        return sensitivities
    out: list[_Sensitivity] = []
    for (j, f), r0, r1, s0, s1 in zip(sensitivities, before.residuals, after.residuals, before.starts, after.starts):
        missed = (r0 - r1).reshape(-1) - j @ step
        if f is not None and s0 is not None and s1 is not None:
            missed -= f @ (s1 - s0)
        out.append((j + np.outer(missed, along / length), f))
    return out


def _inside(model: Model, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Lower and upper limits (P,) of the smooth coordinates; only effects' parameters have their own."""
    low, high = np.full(x.size, -np.inf), np.full(x.size, np.inf)
    for i, name in enumerate(model.free):
        if "." in name:
            low[i], high[i] = model.bounds(name)
    return low, high


def _solve(normal: FloatArray, slope: FloatArray, damping: float, moving: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Damped step (P,) of the ``moving`` parameters, and the undamped one."""
    scale = np.sqrt(np.diagonal(normal))
    scale = np.where(scale > 0.0, scale, 1.0)
    use = np.flatnonzero(moving & (np.diagonal(normal) > 0.0))
    unit = (normal / np.outer(scale, scale))[np.ix_(use, use)]
    values, vectors = np.linalg.eigh(unit)
    values = np.maximum(values, 1e-14 * values[-1]) if values.size else values
    along = vectors.T @ (slope / scale)[use]
    steps = np.zeros((2, slope.size))
    steps[0, use] = vectors @ (along / (values + damping)) / scale[use]
    steps[1, use] = vectors @ (along / values) / scale[use]
    return steps[0], steps[1]


def _descend(problem: _Problem, at: _Point, tasks: tuple[_Task, ...], dof: int) -> tuple[_Point, FloatArray, bool]:
    """From ``at`` down to where the fit stands still: the point, the normal matrix there, whether it converged."""
    low, high = _inside(problem.model, at.x)
    # The loudest record sets the steps of the differences for all, and tells how strong nonlinear effects are.
    loudest = max(range(len(tasks)), key=lambda k: float(np.mean(tasks[k].record.drive_v ** 2)))
    task = tasks[loudest]
    steps = problem.steps(problem.model.to_values(at.x), task, at.starts[loudest])
    exact = problem.strength(problem.model.to_values(at.x), task) > _STRONG
    damping = 0.0
    sensitivities: list[_Sensitivity] | None = None
    normal = np.zeros((at.x.size, at.x.size))
    for _ in range(_ITERATIONS):
        if sensitivities is None:
            sensitivities = _sensitivities(problem, at, tasks, exact, steps)
        normal, slope, back = _equations(problem, at, sensitivities)
        # A parameter at the end of its range moves only inwards.
        moving = ~((at.x <= low) & (slope < 0.0)) & ~((at.x >= high) & (slope > 0.0))
        noise = max(1.0, at.chi2 / dof)
        _, newton = _solve(normal, slope, 0.0, moving)
        expected = float(newton @ slope) + sum(float(b[2] @ b[0] @ b[2]) for b in back if b is not None)
        if expected < _STANDSTILL * noise:
            return at, normal, True
        accepted: _Point | None = None
        for _ in range(8):
            step, _ = _solve(normal, slope, damping, moving)
            x = np.clip(at.x + step, low, high)
            starts = tuple(
                start if b is None or start is None else start + b[0] @ (b[2] - b[1] @ (x - at.x))
                for start, b in zip(at.starts, back)
            )
            trial = _point(problem, x, tasks, starts, at.chi2 + _CLOSE * noise)
            if trial is not None and trial.chi2 <= at.chi2:
                accepted = trial
                break
            if trial is not None and expected < _CLOSE * noise:
                break
            damping = max(30.0 * damping, 1e-4)
        strength = problem.strength(problem.model.to_values((accepted or at).x), task)
        if accepted is None:
            still = expected < _CLOSE * noise
            if still or exact or strength < _FAINT:
                return at, normal, still
            exact, damping, sensitivities = True, 0.0, None
            continue
        fall = at.chi2 - accepted.chi2
        sensitivities = _updated(sensitivities, at, accepted, np.diagonal(normal))
        at = accepted
        damping = 0.0 if damping <= 1e-4 else damping * 0.1
        poor = expected > noise and fall < 0.5 * expected
        was_exact, exact = exact, exact or strength > _STRONG or (poor and strength > _FAINT)
        if fall < _STANDSTILL * noise and exact == was_exact:
            return at, normal, True
        if poor or expected > _SMALL_STEP * noise or exact != was_exact:
            sensitivities = None
    return at, normal, False


def _inverse(normal: FloatArray) -> tuple[FloatArray, bool]:
    """Covariance from the normal matrix, in units of each sensitivity, and whether all are determined."""
    scale = np.sqrt(np.diagonal(normal))
    determined = bool(np.all(scale > 0.0))
    safe = np.where(scale > 0.0, scale, 1.0)
    values, vectors = np.linalg.eigh(normal / np.outer(safe, safe))
    determined = determined and bool(values[0] > 1e-13 * values[-1])
    kept = np.where(values > 1e-13 * values[-1], values, np.inf)
    covariance = (vectors / kept) @ vectors.T / np.outer(safe, safe)
    return np.asarray(covariance), determined


def _judge(problem: _Problem, values: Mapping[str, float], task: _Task, start: FloatArray | None) -> RecordFit:
    """The record as the model explains it; an unknown initial state of a held-out record is refitted."""
    record = task.record
    lost = task.basis.shape[1] * record.sense_v.shape[1] + 2 * task.coordinates
    if task.coordinates and start is None:
        start = np.zeros(2 * task.coordinates)
        f = problem.start_columns(values, task, start, problem.strength(values, task) > _FAINT)
        solve = np.linalg.pinv(f.T @ f, rcond=1e-12, hermitian=True) @ f.T
        for _ in range(6):
            step = solve @ problem.residual(values, task, start).reshape(-1)
            start = start + step
            if float(np.sum((f @ step) ** 2)) < _CLOSE:
                break
    predicted = problem.predict(values, task, start)
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


def fit_campaign(
    model: Model, campaign: Campaign, noise: NoiseLevel, start: Mapping[str, float] | None = None
) -> CampaignFit:
    """Fit ``model`` to the records with role "fit" and judge it on those and the held-out ones.

    Parameters
    ----------
    model : plant and effects; a modal plant takes its numbers of channels from the records.
    campaign : at least one driven record with role "fit".
    noise : sigma of each channel.
    start : parameter values to start from (other names are ignored); what is missing is found from the records
        (plant) or
        starts at its null (effects).

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
    problem = _Problem(model, campaign, sigma_v)
    values = model.complete(begun)
    tasks = tuple(problem.task(record, values) for record in fitted)
    starts = tuple(np.zeros(2 * task.coordinates) if task.coordinates else None for task in tasks)
    at = _point(problem, model.to_internal(values), tasks, starts)
    if at is None and C12 in values:
        values = model.complete({**begun, C12: 0.0})
        at = _point(problem, model.to_internal(values), tasks, starts)
    if at is None:
        raise ConfigError(
            "the fit cannot start here: no such device", value=values, next_step="give other start values"
        )
    dof = sum(r.size for r in at.residuals) - at.x.size
    at, normal, converged = _descend(problem, at, tasks, dof)
    x_covariance, determined = _inverse(normal)
    values = model.to_values(at.x)
    covariance = model.covariance_of_values(at.x, x_covariance)
    # What leaves no trace in the fit records is not known at all.
    unknown = np.where(np.diagonal(normal) > 0.0, 0.0, np.inf)
    sd = dict(zip(model.free, (np.sqrt(np.maximum(np.diagonal(covariance), 0.0)) + unknown).tolist()))
    start_of = {id(task.record): s for task, s in zip(tasks, at.starts)}
    judged = []
    for record in campaign.records:
        if record.role in ("fit", "validate"):
            known = next((task for task in tasks if task.record is record), None)
            judged.append(_judge(problem, values, known or problem.task(record, values), start_of.get(id(record))))
    records = tuple(judged)
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
    return CampaignFit(
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
        bool(converged and determined),
        theta,
        split,
    )
