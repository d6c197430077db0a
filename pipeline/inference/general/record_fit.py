"""One record against a fitted model: residual, chi2, error and misfit; fitted and held-out records alike.

    chi2 = sum |r|^2,    dof = good samples - nuisances,    error = sqrt(chi2 / dof),    misfit = sqrt(max(error^2 - 1, 0))
    relative_error = rms of the residual volts / rms of the measured volts

Shapes: N samples, S senses, n coordinates of an initial state.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ...arrays import BoolArray, FloatArray
from ...experiment.record import Campaign, Role
from .free_states import free_start
from .residuals import CampaignResiduals, Task, Tasks


@dataclass(frozen=True, eq=False)
class RecordFit:
    """One record as the fitted model explains it; symbols at the head of the module.

    Parameters
    ----------
    name, role : of the record.
    predicted_v : (N, S) [V], without nuisances.
    residual : (N, S) in sigmas, nuisances removed.
    chi2, dof, error, relative_error, misfit : of this record alone.
    start : fitted initial state (2n,), ``None`` where the record starts at rest.
    good : (N, S) whether a sample counts; bad ones have residual 0.  ``None``: all count.
    rms_v : (S,) of measured - predicted [V], nuisances removed.
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
    rms_v: FloatArray
    good: BoolArray | None = None


def misfit_of(error: float) -> float:
    """sqrt(max(error^2 - 1, 0))."""
    return float(np.sqrt(max(error**2 - 1.0, 0.0)))


def record_fit(problem: CampaignResiduals, task: Task, start: FloatArray | None, predicted_v: FloatArray) -> RecordFit:
    """The record of ``task`` against a prediction (N, S) [V] that begins in the state ``start`` (2n,)."""
    record = task.record
    nuisances = task.basis.shape[1] * record.sense_v.shape[1] + 2 * task.coordinates
    residual = problem.whiten(record.sense_v - predicted_v, task)
    good = record.good
    samples = residual.size if good is None else int(np.count_nonzero(good))
    chi2, dof = float(np.vdot(residual, residual)), samples - nuisances
    error = float(np.sqrt(chi2 / dof))
    level = float(np.sqrt(np.mean(record.sense_v**2)))
    # Bad samples have a rest of zero.  Signals in the noise of a record, such as its own start time, do not count as misfit.
    plain = task.whitening.common is None
    rest_v = problem.without_nuisances(record.sense_v - predicted_v, task) if plain else residual * problem.sigma_v
    rms_v = np.sqrt(np.sum(rest_v**2, axis=0) * residual.shape[1] / samples)
    relative = float(np.sqrt(np.mean(rms_v**2))) / max(level, 1e-300)
    return RecordFit(
        record.name,
        record.role,
        predicted_v,
        residual,
        chi2,
        dof,
        error,
        relative,
        misfit_of(error),
        start,
        rms_v,
        good,
    )


def held_out_fit(problem: CampaignResiduals, values: Mapping[str, float], task: Task) -> RecordFit:
    """A record that was not fitted; only its unknown initial state is fitted, at complete ``values``."""
    alone, start = Tasks((task,), (((0,), task.group),)), free_start(problem, values, task)
    (predicted_v,) = problem.predictions(values, alone, [start])
    return record_fit(problem, task, start, predicted_v)


def pooled_errors(records: Sequence[RecordFit], campaign: Campaign, parameters: int) -> tuple[float, float]:
    """error and relative_error of several records together, ``parameters`` of which were fitted."""
    chi2 = sum(record.chi2 for record in records)
    dof = sum(record.dof for record in records) - parameters
    rest = sum(record.residual.shape[0] * float(np.sum(record.rms_v**2)) for record in records)
    names = {record.name for record in records}
    total = sum(float(np.sum(record.sense_v**2)) for record in campaign.records if record.name in names)
    return float(np.sqrt(chi2 / dof)), float(np.sqrt(rest / max(total, 1e-300)))
