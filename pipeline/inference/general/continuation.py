"""Fits that stop early or end in a wrong minimum: restarts, and continuation in the length of the records.

    restart        the fit goes on from where it stopped, with fresh columns and damping, while it still falls
    continuation   x_n = argmin chi2 of the first n samples, from x_(n/2);      n = N/32, N/16, .. , N

Where the motion is strongly nonlinear, an error of its phase grows along a record, so chi2 of whole records has many minima.  In
short records the phase errors are small and chi2 has one minimum (multiple shooting rests on the same fact: Bock, 1983).

Shapes: N samples, P free parameters.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...experiment.forward.sensitivity import STRONG, is_integrated
from ...experiment.record import Record
from .gauss_newton import CLOSE, PATIENCE, GaussNewtonResult, minimise
from .linear_step import FitPoint, point_at
from .residuals import CampaignResiduals, Tasks

#: Lengths of the first fits over that of the records.
_SHARES = (1 / 32, 1 / 16, 1 / 8, 1 / 4, 1 / 2)


def restarted(problem: CampaignResiduals, result: GaussNewtonResult, tasks: Tasks, dof: int) -> GaussNewtonResult:
    """``result``, or the end of restarts from where it stopped until one converges or no longer falls; see ``minimise``.

    A Silverbox record at 100 mV needs two.
    """
    for _ in range(PATIENCE):
        if result.converged:
            break
        before = result.at.chi2
        result = minimise(problem, result.at, tasks, dof)
        if before - result.at.chi2 < CLOSE * before:
            break
    return result


def continued(
    problem: CampaignResiduals,
    first: FitPoint,
    result: GaussNewtonResult,
    tasks: Tasks,
    dof: int,
    noise_measured: bool,
) -> GaussNewtonResult:
    """The better of ``result`` and a continuation in length from the point ``first``, where the response is strongly nonlinear.

    Parameters
    ----------
    problem, tasks, dof : as for ``minimise``.
    first : the start of the fit; a continuation is made only if it lies at the null of a force or sense law.
    result : the fit from there.
    noise_measured : chi2 can say that the fit explains the records; a level from the driven records themselves cannot.
    """
    model = problem.model
    begin, end = model.to_values(first.x), model.to_values(result.at.x)
    unstarted = [n for n in model.free if is_integrated(model, n) and begin[n] == model.by_name[n].null]
    if not any(np.any(task.record.drive_v) for task in tasks.each):
        # The pieces of a decay are short already, each with a state of its own.
        return result
    explained = result.at.chi2 < dof + 6.0 * (2.0 * dof) ** 0.5
    if not unstarted or (noise_measured and explained):
        return result
    if result.converged and _relative(problem, result.at, tasks) < CLOSE:
        return result
    if max(problem.strength(end, task, start) for task, start in zip(tasks.each, result.at.starts)) < STRONG:
        return result
    # The end of a fit in a wrong minimum is nearer to the right one than its start, but not always.
    for at in (result.at, first):
        found = _continued(problem, at, tasks, dof)
        if found is not None and found.at.chi2 < result.at.chi2:
            result = found
        if result.converged and _relative(problem, result.at, tasks) < CLOSE:
            break
    return result


def _continued(problem: CampaignResiduals, at: FitPoint, tasks: Tasks, dof: int) -> GaussNewtonResult | None:
    """The fit from ``at`` by way of the first samples of the records; ``None`` where a point is not allowed."""
    values = problem.model.to_values(at.x)
    for share in _SHARES:
        short = problem.tasks(
            [beginning(task.record, max(int(share * task.record.drive_v.shape[0]), 1)) for task in tasks.each], values
        )
        start = point_at(problem, at.x, short, at.starts)
        if start is None:
            return None
        free = max(sum(r.size for r in start.residuals) - at.x.size, 1)
        at = restarted(problem, minimise(problem, start, short, free), short, free).at
    whole = point_at(problem, at.x, tasks, at.starts)
    return None if whole is None else minimise(problem, whole, tasks, dof)


def _relative(problem: CampaignResiduals, at: FitPoint, tasks: Tasks) -> float:
    """Rms of the residual over that of the records [1]."""
    left = sum(float(np.sum((r * problem.sigma_v) ** 2)) for r in at.residuals)
    return float(np.sqrt(left / sum(float(np.sum(task.record.sense_v**2)) for task in tasks.each)))


def beginning(record: Record, samples: int) -> Record:
    """The first samples of a record; its own name keeps it apart from the whole record."""
    return replace(
        record,
        name=f"{record.name}[:{samples}]",
        drive_v=record.drive_v[:samples].copy(),
        sense_v=record.sense_v[:samples].copy(),
    )
