"""Gauss-Newton with Levenberg's damping, down to where a fit of a campaign stands still.

Columns are computed while steps are long and updated (Broyden, Math. Comp. 19 (1965) 577) where they are short; the residual
is always exact.  Initial states of records that do not start at rest are eliminated record by record.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ...arrays import BoolArray, FloatArray
from ...device.model import Model
from ...errors import ConfigError
from ...experiment.forward.drive_groups import highest_drive_energy
from ...experiment.forward.sensitivity import STRONG, is_integrated
from .linearized import LinearizedResiduals
from .residuals import CampaignResiduals, Tasks

_ITERATIONS = 24
#: Expected fall of chi2 (in units of chi2/dof, at least 1) at which the fit stands still: 3 % of a sd.
_STANDSTILL = 1e-3
#: The same where a trial does not fall any more: rounding and inexact columns, a tenth of a sd.
CLOSE = 1e-2
_LEAST_DAMPING = 1e-2
#: After so many steps a fall by this share of the misfit is none.
_PATIENCE, _CREEP = 8, 1e-4
#: Once the records have moved by this share of themselves columns are computed anew; before, updated, they serve.
_FAR = 5e-3
#: The same for the parameters of forces and pick-off laws, as a share of each: what is weak hardly moves the records.
_RESIZED = 0.1
#: Share of a fall of chi2 that a frozen problem may miss and still have the right slopes.
_FORETOLD = 0.02
#: Columns computed where the records were by at most this share of them elsewhere are those of the end.
_STALE = 1e-3
#: Relative strength of nonlinear effects below which columns always suffice without them.
FAINT = 1e-3
#: Above this their absence may be why a step falls short, and their slopes at their null are no longer those of the end.
_NOTABLE = 1e-2

#: Inverse normal matrix of an initial state, its cross terms with x, its slope.
_Back = tuple[FloatArray, FloatArray, FloatArray]


@dataclass(frozen=True, eq=False)
class FitPoint:
    """Where the fit stands: smooth coordinates, initial states by record, volts and residuals, chi2 with priors."""

    x: FloatArray
    starts: tuple[FloatArray | None, ...]
    predicted: tuple[FloatArray, ...]
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


def point_at(
    problem: CampaignResiduals,
    x: FloatArray,
    tasks: Tasks,
    starts: tuple[FloatArray | None, ...],
    most: float = np.inf,
) -> FitPoint | None:
    """The point at ``x``, or ``None`` where no device can be or chi2 exceeds ``most``."""
    try:
        values = problem.model.to_values(x)
        if not problem.model.allowed(values):
            return None
        predicted = tuple(problem.predictions(values, tasks, starts))
        residuals = tuple(problem.rests(predicted, tasks))
        chi2 = float(np.sum(_prior_rows(problem.model, values)[0] ** 2))
        chi2 += sum(float(np.vdot(r, r)) for r in residuals)
        if not (np.isfinite(chi2) and chi2 <= most):
            return None
    except (ConfigError, np.linalg.LinAlgError):
        return None
    return FitPoint(x, starts, predicted, residuals, chi2)


#: Columns of x (N S, P) and of the initial state (N S, 2 n) of a record that does not start at rest, in sigmas.
Sensitivity = tuple[FloatArray, FloatArray | None]


@dataclass(frozen=True, eq=False)
class GaussNewtonResult:
    """Where a descent ended: the point, the normal matrix there, the columns of each record, whether it converged."""

    at: FitPoint
    normal: FloatArray
    sensitivities: list[Sensitivity]
    converged: bool


def _sensitivities(
    problem: CampaignResiduals, at: FitPoint, tasks: Tasks, exact: bool, steps: FloatArray
) -> list[Sensitivity]:
    values = problem.model.to_values(at.x)
    free = [
        None if start is None else problem.start_columns(values, task, start, exact)
        for task, start in zip(tasks.each, at.starts)
    ]
    return list(zip(problem.columns(values, tasks, at.starts, exact, steps), free))


def _equations(
    problem: CampaignResiduals, at: FitPoint, sensitivities: list[Sensitivity]
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
        turned = rows[1][:, None] * problem.model.values_jacobian(at.x)
        normal += turned.T @ turned
        slope -= turned.T @ rows[0]
    return normal, slope, back


def _updated(
    sensitivities: list[Sensitivity], before: FitPoint, after: FitPoint, weight: FloatArray
) -> list[Sensitivity]:
    """Broyden's update: the columns of x put right along the step just made, at no cost."""
    step = after.x - before.x
    along = weight * step
    length = float(along @ step)
    if length == 0.0:
        return sensitivities
    out: list[Sensitivity] = []
    for (j, f), r0, r1, s0, s1 in zip(sensitivities, before.residuals, after.residuals, before.starts, after.starts):
        missed = (r0 - r1).reshape(-1) - j @ step
        if f is not None and s0 is not None and s1 is not None:
            missed -= f @ (s1 - s0)
        out.append((j + np.outer(along / length, missed).T, f))
    return out


def moved_share(before: Sequence[FloatArray], after: Sequence[FloatArray]) -> float:
    """How far records moved, as a share of themselves."""
    change = sum(float(np.sum((b - a) ** 2)) for a, b in zip(before, after))
    return float(np.sqrt(change / max(sum(float(np.sum(a**2)) for a in before), 1e-300)))


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


def descend(problem: CampaignResiduals, at: FitPoint, tasks: Tasks, dof: int) -> GaussNewtonResult:
    """From ``at`` down to where the fit stands still; with weak forces and pick-off laws most of the way without them."""
    values, loud = problem.model.to_values(at.x), _highest_drive_energy(tasks)
    steps = problem.steps(values, tasks.each[loud], at.starts[loud])
    bends = any(is_integrated(problem.model, name) for name in problem.model.free)
    if not bends or problem.strength(values, tasks.each[loud]) > STRONG:
        return _descend(problem, at, tasks, dof, steps)
    frozen = LinearizedResiduals(problem, values, tasks, at.starts, steps)
    there = _descend(frozen, at, tasks, dof, steps)
    nearer = point_at(problem, there.at.x, tasks, there.at.starts, at.chi2)
    if nearer is None:
        return _descend(problem, at, tasks, dof, steps)
    weak = problem.strength(problem.model.to_values(nearer.x), tasks.each[loud]) <= _NOTABLE
    # Slopes that foretold what came are those of the end: an inverse gap may have doubled, and its slope with it.
    missed, fall = abs(nearer.chi2 - there.at.chi2), at.chi2 - nearer.chi2
    foretold = missed <= max(1.0, nearer.chi2 / dof, _FORETOLD * fall)
    return _descend(problem, nearer, tasks, dof, steps, there.sensitivities if weak and foretold else None)


def _highest_drive_energy(tasks: Tasks) -> int:
    """The record that sets the steps of the differences for all, and tells how strong nonlinear effects are."""
    return highest_drive_energy([task.record.drive_v for task in tasks.each])


def _descend(
    problem: CampaignResiduals,
    at: FitPoint,
    tasks: Tasks,
    dof: int,
    steps: FloatArray,
    sensitivities: list[Sensitivity] | None = None,
) -> GaussNewtonResult:
    low, high = _inside(problem.model, at.x)
    task = tasks.each[_highest_drive_energy(tasks)]
    exact = problem.strength(problem.model.to_values(at.x), task) > STRONG
    damping = 0.0
    computed, paused = at, False
    normal = np.zeros((at.x.size, at.x.size))

    def serve(most: float) -> bool:
        near = moved_share(computed.predicted, at.predicted) <= most
        return near and problem.resized(computed.x, at.x) <= _RESIZED

    def stand(converged: bool) -> GaussNewtonResult:
        if sensitivities is not None and serve(_STALE):
            return GaussNewtonResult(at, normal, sensitivities, converged)
        fresh = _sensitivities(problem, at, tasks, exact, steps)
        return GaussNewtonResult(at, _equations(problem, at, fresh)[0], fresh, converged)

    for passes in range(_ITERATIONS):
        fresh = sensitivities is None
        if sensitivities is None:
            sensitivities, computed = _sensitivities(problem, at, tasks, exact, steps), at
        normal, slope, back = _equations(problem, at, sensitivities)
        # A parameter at the end of its range moves only inwards.
        moving = ~((at.x <= low) & (slope < 0.0)) & ~((at.x >= high) & (slope > 0.0))
        noise = max(1.0, at.chi2 / dof)
        _, newton = _solve(normal, slope, 0.0, moving)
        expected = float(newton @ slope) + sum(float(b[2] @ b[0] @ b[2]) for b in back if b is not None)
        if expected < _STANDSTILL * noise:
            return stand(True)
        accepted: FitPoint | None = None
        for _ in range(8):
            step, _ = _solve(normal, slope, damping, moving)
            x = np.clip(at.x + step, low, high)
            starts = tuple(
                start if b is None or start is None else start + b[0] @ (b[2] - b[1] @ (x - at.x))
                for start, b in zip(at.starts, back)
            )
            trial = point_at(problem, x, tasks, starts, at.chi2 + CLOSE * noise)
            if trial is not None and trial.chi2 <= at.chi2:
                accepted = trial
                break
            if trial is not None and expected < CLOSE * noise:
                break
            damping = max(30.0 * damping, _LEAST_DAMPING)
        strength = problem.strength(problem.model.to_values((accepted or at).x), task)
        if accepted is None and not fresh and expected >= CLOSE * noise:
            sensitivities, damping = None, 0.0
            continue
        if accepted is None:
            # Where samples clip and unclip chi2 has kinks: it stood still before columns were made anew, and does so now.
            still = paused or expected < CLOSE * noise
            if still or exact or strength < FAINT:
                return stand(still)
            exact, damping, sensitivities = True, 0.0, None
            continue
        fall = at.chi2 - accepted.chi2
        sensitivities = _updated(sensitivities, at, accepted, np.diagonal(normal))
        at = accepted
        damping = 0.0 if damping <= _LEAST_DAMPING else damping * 0.1
        poor = expected > noise and fall < 0.5 * expected
        was_exact, exact = exact, exact or strength > STRONG or (poor and fresh and strength > _NOTABLE)
        # A model that is wrong may creep along a valley for ever, by nothing beside the misfit that stays.
        creep = _CREEP * max(at.chi2 - dof, 0.0) if passes >= _PATIENCE else 0.0
        paused = fall < max(_STANDSTILL * noise, creep) and exact == was_exact
        if paused and (fresh or expected < CLOSE * noise or creep > _STANDSTILL * noise):
            return stand(True)
        if paused:
            # Much was expected: not the fit stands still, its old columns do.
            sensitivities, damping = None, 0.0
        elif poor or exact != was_exact or not serve(_FAR):
            sensitivities = None
    return stand(False)


def covariance_of(normal: FloatArray) -> tuple[FloatArray, bool]:
    """Covariance from the normal matrix, in units of each sensitivity, and whether all are determined."""
    scale = np.sqrt(np.diagonal(normal))
    determined = bool(np.all(scale > 0.0))
    safe = np.where(scale > 0.0, scale, 1.0)
    values, vectors = np.linalg.eigh(normal / np.outer(safe, safe))
    determined = determined and bool(values[0] > 1e-13 * values[-1])
    kept = np.where(values > 1e-13 * values[-1], values, np.inf)
    covariance = (vectors / kept) @ vectors.T / np.outer(safe, safe)
    return np.asarray(covariance), determined
