"""The free initial state of a record at given parameters: linear least squares, or where nonlinear effects act

    s_n = argmin chi2 of the first n samples, from s_(n/2),      n = three cycles of the lowest mode, .. , N

A few cycles determine a state whatever the frequency; over a whole record the linear motion may be out of step with it.

Shapes: N samples, S senses, n coordinates.  A state (2n,) is [V s, V].
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ...arrays import FloatArray
from ...errors import ConfigError
from .continuation import beginning
from .gauss_newton import CLOSE, FAINT, ITERATIONS, PATIENCE
from .residuals import CampaignResiduals, Task, Tasks, start_step

#: Cycles of the lowest mode, and samples per unknown of the state, from which it is determined first.
_CYCLES, _SAMPLES = 3.0, 8


def free_start(problem: CampaignResiduals, values: Mapping[str, float], task: Task) -> FloatArray | None:
    """The initial state (2n,) that explains a record best at complete ``values``; ``None``: at rest.

    Raises
    ------
    ConfigError : no device can have ``values``.
    """
    if not task.coordinates:
        return None
    samples, rate = task.record.sense_v.shape[0], task.record.sample_rate_hz
    stiffness = np.diagonal(problem.system(values, task.group).mechanics.stiffness[0])
    lowest_hz = float(np.sqrt(stiffness.min())) / (2.0 * np.pi)
    n = max(int(_CYCLES * rate / lowest_hz), _SAMPLES * 2 * task.coordinates)
    first = task if n >= samples else problem.task(beginning(task.record, n), values)
    state = problem.linear_start(values, first)
    assert state is not None
    if _strength(problem, values, task, state) <= FAINT:
        return problem.linear_start(values, task)
    while n < samples:
        short = problem.task(beginning(task.record, n), values)
        state = settled(problem, values, short, state, PATIENCE)
        n *= 2
    return settled(problem, values, task, state, ITERATIONS)


def _strength(problem: CampaignResiduals, values: Mapping[str, float], task: Task, start: FloatArray) -> float:
    """The strength [1] of nonlinear effects from a state (2n,); infinite where the motion diverges."""
    try:
        return problem.strength(values, task, start)
    except ConfigError:
        return np.inf


def settled(
    problem: CampaignResiduals, values: Mapping[str, float], task: Task, start: FloatArray, iterations: int
) -> FloatArray:
    """Gauss-Newton on the state (2n,) of a record; a step that raises chi2 is halved."""
    alone = Tasks((task,), (((0,), task.group),))

    def residual(at: FloatArray) -> FloatArray | None:
        try:
            found = problem.residuals(values, alone, [at])[0]
        except ConfigError:
            return None
        return found if np.all(np.isfinite(found)) else None

    now = residual(start)
    if now is None:
        # The linear state is too large for the nonlinear forces.
        start = np.zeros_like(start)
        now = problem.residuals(values, alone, [start])[0]
    for _ in range(iterations):
        columns = problem.start_columns(values, task, start, True)
        step = start_step(columns, now)
        for _ in range(PATIENCE):
            trial = residual(start + step)
            if trial is not None and np.vdot(trial, trial) <= np.vdot(now, now):
                break
            step = 0.5 * step
        else:
            return start
        start, now = start + step, trial
        if float(np.sum((columns @ step) ** 2)) < CLOSE * max(1.0, float(np.vdot(now, now)) / now.size):
            break
    return start
