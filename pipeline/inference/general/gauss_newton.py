"""Gauss-Newton with Levenberg damping for the fit of a campaign.

The residual is always exact; the columns of the Jacobian are expensive.  They are computed where steps are long, corrected by
Broyden updates where steps are short, and omit the nonlinear effects while those are weak.  A fit with weak forces and sense
laws first converges on residuals that are linearized in their parameters.

The in-band fit (``screening.fit``) has its own loop: its Jacobian is compiled and costs less than the bookkeeping of updates,
and it limits the step by the radius of its pole expansion, so the two share no damping rule.

Shapes: N samples, S senses, P free parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...arrays import BoolArray, FloatArray
from ...device.model import Model
from ...experiment.forward.drive_groups import highest_drive_energy
from ...experiment.forward.sensitivity import STRONG, is_integrated
from .linear_step import (
    Elimination,
    FitPoint,
    Sensitivity,
    broyden_update,
    damped_step,
    expected_decrease,
    normal_equations,
    point_at,
    relative_change,
    sensitivities_at,
    starts_after,
)
from .linearized import LinearizedResiduals
from .residuals import CampaignResiduals, Tasks

#: Largest number of steps of an iteration that ends by itself.
ITERATIONS = 24
#: Largest number of attempts that each repeat a whole calculation: trials of a step, restarts, corrections, peaks tried.
PATIENCE = 8
#: What counts as nothing: an expected decrease of chi2, in units of chi2/dof (at least 1; 3 % of a sd); a relative change of the
#: records, for which columns are returned with the result; the relative strength of nonlinear effects, for which columns without
#: them suffice.
FAINT = 1e-3
#: What counts as close: an expected decrease of chi2 where no trial lowers it, because of rounding and inexact columns (a tenth
#: of a sd); a strength of nonlinear effects whose absence may be why a step fails; the damping after the first rejected trial.
CLOSE = 1e-2
#: Factor of the damping after a rejected trial, and its inverse after an accepted one, down to ``FAINT``**2.  Without damping
#: between that and ``CLOSE``, a fit whose frequencies hardly differ from a shift of all records (5e-5 of their information is
#: left) crept by 0.2 of an expected 40 and stopped 300 above its minimum, as "fit failed" (bench-one 9, seed 2034).
_DAMPED = 30.0
#: Damping from which a step is short beside the sensitivity of every parameter.  A negligible decrease then says that the
#: columns promise more than the kinks of a law allow: beside a hysteresis, the last five of nine steps gained 0.05 in all
#: and took half of the time (bench-foreign 1, seed 2048).
_STUCK = 1.0
#: Part of a sd by which a result may still move when it counts as settled.
SETTLED = 0.3


@dataclass(frozen=True, eq=False)
class GaussNewtonResult:
    """The end of a fit: its point, normal matrix (P, P) [1/unit of x, squared], the columns of each record, convergence."""

    at: FitPoint
    normal: FloatArray
    sensitivities: Sequence[Sensitivity]
    converged: bool


def minimise(problem: CampaignResiduals, at: FitPoint, tasks: Tasks, dof: int) -> GaussNewtonResult:
    """Minimise chi2 from ``at``.

    Parameters
    ----------
    problem : the residuals; its model gives limits, priors and smooth coordinates.
    at : an allowed point.
    tasks : the fit records.
    dof : degrees of freedom of chi2.
    """
    values, reference = problem.model.to_values(at.x), _reference_record(tasks)
    steps = problem.steps(values, tasks.each[reference], at.starts[reference])
    integrated = any(is_integrated(problem.model, name) for name in problem.model.free)
    if not integrated or problem.strength(values, tasks.each[reference], at.starts[reference]) > STRONG:
        return _minimise(problem, at, tasks, dof, steps)
    linear = _minimise(LinearizedResiduals(problem, values, tasks, at.starts, steps), at, tasks, dof, steps)
    nearer = point_at(problem, linear.at.x, tasks, linear.at.starts, at.chi2)
    if nearer is None:
        return _minimise(problem, at, tasks, dof, steps)
    nearer_values, start = problem.model.to_values(nearer.x), nearer.starts[reference]
    weak = problem.strength(nearer_values, tasks.each[reference], start) <= CLOSE
    # Columns are kept only if they predicted chi2: an inverse gap may have doubled, and its column with it.
    missed, decrease = abs(nearer.chi2 - linear.at.chi2), at.chi2 - nearer.chi2
    predicted = missed <= max(1.0, nearer.chi2 / dof, CLOSE * decrease)
    return _minimise(problem, nearer, tasks, dof, steps, linear.sensitivities if weak and predicted else None)


def _reference_record(tasks: Tasks) -> int:
    """The record that sets the steps of all differences and the strength of nonlinear effects."""
    return highest_drive_energy([task.record.drive_v for task in tasks.each])


def _limits(model: Model, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Lower and upper limits (P,) of the smooth coordinates; only parameters of effects have their own."""
    low, high = np.full(x.size, -np.inf), np.full(x.size, np.inf)
    for i, name in enumerate(model.free):
        if "." in name:
            low[i], high[i] = model.bounds(name)
    return low, high


def _columns_hold(problem: CampaignResiduals, computed: FitPoint, at: FitPoint, change: float) -> bool:
    """Whether columns computed at one point hold at another: a small relative change of records and of nonlinear sizes."""
    # Parameters of forces and sense laws change the records little where they are weak.
    near = relative_change(computed.predicted, at.predicted) <= change
    return near and problem.relative_size_change(computed.x, at.x) <= STRONG


@dataclass(frozen=True, eq=False)
class _LinearStep:
    """The linearized problem at a point: normal equations, the parameters that may move, the noise level of chi2."""

    normal: FloatArray
    slope: FloatArray
    eliminated: Sequence[Elimination | None]
    moving: BoolArray
    noise: float
    expected: float


def _linear_step(
    problem: CampaignResiduals,
    at: FitPoint,
    sensitivities: Sequence[Sensitivity],
    limits: tuple[FloatArray, FloatArray],
    dof: int,
) -> _LinearStep:
    normal, slope, eliminated = normal_equations(problem.model, at, sensitivities)
    # A parameter at the end of its range moves only inwards.
    moving = ~((at.x <= limits[0]) & (slope < 0.0)) & ~((at.x >= limits[1]) & (slope > 0.0))
    _, newton = damped_step(normal, slope, 0.0, moving)
    noise = max(1.0, at.chi2 / dof)
    return _LinearStep(normal, slope, eliminated, moving, noise, expected_decrease(slope, newton, eliminated))


def _accepted(
    problem: CampaignResiduals,
    at: FitPoint,
    tasks: Tasks,
    linear: _LinearStep,
    limits: tuple[FloatArray, FloatArray],
    damping: float,
) -> tuple[FitPoint | None, float]:
    """The first trial that does not raise chi2, each with more damping than the one before; and its damping."""
    for _ in range(PATIENCE):
        step, _ = damped_step(linear.normal, linear.slope, damping, linear.moving)
        x = np.clip(at.x + step, *limits)
        starts = starts_after(at.starts, linear.eliminated, x - at.x)
        trial = point_at(problem, x, tasks, starts, at.chi2 + CLOSE * linear.noise)
        if trial is not None and trial.chi2 <= at.chi2:
            return trial, damping
        if trial is not None and linear.expected < CLOSE * linear.noise:
            break
        damping = max(_DAMPED * damping, CLOSE)
    return None, damping


def _minimise(
    problem: CampaignResiduals,
    at: FitPoint,
    tasks: Tasks,
    dof: int,
    steps: FloatArray,
    sensitivities: Sequence[Sensitivity] | None = None,
) -> GaussNewtonResult:
    limits = _limits(problem.model, at.x)
    reference = _reference_record(tasks)
    task = tasks.each[reference]
    exact = problem.strength(problem.model.to_values(at.x), task, at.starts[reference]) > STRONG
    damping = 0.0
    computed, paused = at, False
    normal = np.zeros((at.x.size, at.x.size))

    def result(converged: bool) -> GaussNewtonResult:
        if sensitivities is not None and _columns_hold(problem, computed, at, FAINT):
            return GaussNewtonResult(at, normal, sensitivities, converged)
        fresh = sensitivities_at(problem, at, tasks, exact, steps)
        return GaussNewtonResult(at, normal_equations(problem.model, at, fresh)[0], fresh, converged)

    for iteration in range(ITERATIONS):
        fresh = sensitivities is None
        if sensitivities is None:
            sensitivities, computed = sensitivities_at(problem, at, tasks, exact, steps), at
        linear = _linear_step(problem, at, sensitivities, limits, dof)
        normal, noise, expected = linear.normal, linear.noise, linear.expected
        if expected < FAINT * noise:
            return result(True)
        accepted, damping = _accepted(problem, at, tasks, linear, limits, damping)
        now = accepted or at
        strength = problem.strength(problem.model.to_values(now.x), task, now.starts[reference])
        if accepted is None and not fresh and expected >= CLOSE * noise:
            sensitivities, damping = None, 0.0
            continue
        if accepted is None:
            # chi2 has kinks where samples start to clip: it did not decrease before the columns were recomputed, nor after.
            converged = paused or expected < CLOSE * noise
            if converged or exact or strength < FAINT:
                return result(converged)
            exact, damping, sensitivities = True, 0.0, None
            continue
        decrease = at.chi2 - accepted.chi2
        sensitivities = broyden_update(sensitivities, at, accepted, np.diagonal(normal))
        at = accepted
        stuck, damping = damping > _STUCK, 0.0 if damping <= FAINT**2 else damping / _DAMPED
        poor = expected > noise and decrease < 0.5 * expected
        was_exact, exact = exact, exact or strength > STRONG or (poor and fresh and strength > CLOSE)
        # A wrong model may creep along a valley for ever, by steps that are negligible beside the remaining misfit; a mode far
        # above the band took 51 steps along a curved ridge that gained 0.5 in all.
        slow = SETTLED**2 * noise if stuck or iteration >= PATIENCE else 0.0
        if iteration >= PATIENCE:
            slow = max(slow, FAINT * (at.chi2 - dof))
        paused = decrease < max(FAINT * noise, slow) and exact == was_exact
        if paused and (fresh or expected < CLOSE * noise or slow > FAINT * noise):
            return result(True)
        if paused:
            # A larger decrease was expected, so the columns are outdated rather than the fit converged.
            sensitivities, damping = None, 0.0
        elif poor or exact != was_exact or not _columns_hold(problem, computed, at, CLOSE):
            sensitivities = None
    return result(False)
