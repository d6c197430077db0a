"""A point of a fit, its sensitivities, and the linear step from it.

    (J^T J + B^T B) dx = J^T r + B^T b         J = -dr/dx of all records, b = (value - mean)/sd of normal priors, B = db/dx

The initial states s of records that do not start at rest are eliminated record by record:  s = (F^T F)^-1 F^T (r - J dx).

Shapes: N samples, S senses, P free parameters, n coordinates of an initial state; residuals and columns in sigmas.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ...arrays import BoolArray, FloatArray
from ...device.model import Model
from ...errors import ConfigError
from .residuals import CampaignResiduals, Tasks

#: Columns of x (N S, P) and of the initial state (N S, 2 n; ``None``: at rest) of a record.
Sensitivity = tuple[FloatArray, FloatArray | None]
#: For one record: (F^T F)^-1 (2n, 2n), its cross terms with x F^T J (2n, P), and F^T r (2n,).
Elimination = tuple[FloatArray, FloatArray, FloatArray]


@dataclass(frozen=True, eq=False)
class FitPoint:
    """One point of a fit.

    Parameters
    ----------
    x : smooth coordinates (P,) [units of ``Model``].
    starts : initial state (2n,) [V s, V] of each record, ``None`` where it starts at rest.
    predicted : (N, S) [V] of each record.
    residuals : (N, S) of each record, in sigmas.
    chi2 : of the residuals and the priors.
    """

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
    chi2_max: float = np.inf,
) -> FitPoint | None:
    """The point at ``x`` (P,) [units of ``Model``]; ``None`` where ``x`` is out of range or chi2 exceeds ``chi2_max``."""
    try:
        values = problem.model.to_values(x)
        if not problem.model.allowed(values):
            return None
        predicted = tuple(problem.predictions(values, tasks, starts))
        residuals = tuple(problem.residuals_of(predicted, tasks))
        chi2 = float(np.sum(_prior_rows(problem.model, values)[0] ** 2))
        chi2 += sum(float(np.vdot(r, r)) for r in residuals)
        if not (np.isfinite(chi2) and chi2 <= chi2_max):
            return None
    except (ConfigError, np.linalg.LinAlgError):
        return None
    return FitPoint(x, starts, predicted, residuals, chi2)


def sensitivities_at(
    problem: CampaignResiduals, at: FitPoint, tasks: Tasks, exact: bool, steps: FloatArray
) -> list[Sensitivity]:
    """Columns (N S, P) of each record, sigmas per unit of x; ``exact``, ``steps`` (P,) as in ``CampaignResiduals.columns``."""
    values = problem.model.to_values(at.x)
    free = [
        None if start is None else problem.start_columns(values, task, start, exact)
        for task, start in zip(tasks.each, at.starts)
    ]
    return list(zip(problem.columns(values, tasks, at.starts, exact, steps), free))


def with_starts(sensitivities: Sequence[Sensitivity]) -> list[FloatArray]:
    """For each record the columns (N S, P + all initial states): those of the parameters, then of every initial state."""
    width = sum(0 if f is None else f.shape[1] for _, f in sensitivities)
    out, place = [], 0
    for j, f in sensitivities:
        wide = np.zeros((j.shape[0], width))
        if f is not None:
            wide[:, place : place + f.shape[1]] = f
            place += f.shape[1]
        out.append(np.concatenate([j, wide], axis=1))
    return out


def normal_equations(
    model: Model, at: FitPoint, sensitivities: Sequence[Sensitivity]
) -> tuple[FloatArray, FloatArray, list[Elimination | None]]:
    """J^T J (P, P) and J^T r (P,) with priors [sigma^2 over units of x], initial states eliminated; what recovers those."""
    size = at.x.size
    normal, slope = np.zeros((size, size)), np.zeros(size)
    eliminated: list[Elimination | None] = []
    for (j, f), residual in zip(sensitivities, at.residuals):
        r = residual.reshape(-1)
        normal += j.T @ j
        slope += j.T @ r
        if f is None:
            eliminated.append(None)
            continue
        inverse: FloatArray = np.linalg.pinv(f.T @ f, rcond=1e-12, hermitian=True).astype(np.float64)
        cross, own = f.T @ j, f.T @ r
        normal -= cross.T @ inverse @ cross
        slope -= cross.T @ inverse @ own
        eliminated.append((inverse, cross, own))
    rows = _prior_rows(model, model.to_values(at.x))
    if np.any(rows[1]):
        jacobian = rows[1][:, None] * model.values_jacobian(at.x)
        normal += jacobian.T @ jacobian
        slope -= jacobian.T @ rows[0]
    return normal, slope, eliminated


def starts_after(
    starts: Sequence[FloatArray | None], eliminated: Sequence[Elimination | None], dx: FloatArray
) -> tuple[FloatArray | None, ...]:
    """The initial states (2n,) [V s, V] that minimise chi2 after a step ``dx`` (P,) of x."""
    return tuple(
        start if e is None or start is None else start + e[0] @ (e[2] - e[1] @ dx)
        for start, e in zip(starts, eliminated)
    )


def expected_decrease(slope: FloatArray, newton: FloatArray, eliminated: Sequence[Elimination | None]) -> float:
    """Decrease of chi2 [1] after the undamped step ``newton`` (P,), for linear residuals; ``slope`` (P,) = J^T r."""
    return float(newton @ slope) + sum(float(e[2] @ e[0] @ e[2]) for e in eliminated if e is not None)


def damped_step(
    normal: FloatArray, slope: FloatArray, damping: float, moving: BoolArray
) -> tuple[FloatArray, FloatArray]:
    """Damped step (P,) [units of x] of the ``moving`` parameters (P,), and the undamped one, from J^T J (P, P), J^T r (P,).

    ``damping`` is added to the eigenvalues of the normal matrix in units of each parameter's own sensitivity (Levenberg,
    Quart. Appl. Math. 2 (1944) 164).
    """
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


def broyden_update(
    sensitivities: Sequence[Sensitivity], before: FitPoint, after: FitPoint, weight: FloatArray
) -> list[Sensitivity]:
    """Columns (N S, P) in sigmas corrected along the last step (Broyden, Math. Comp. 19 (1965) 577); ``weight`` (P,)."""
    step = after.x - before.x
    along = weight * step
    length = float(along @ step)
    if length == 0.0:
        return list(sensitivities)
    out: list[Sensitivity] = []
    for (j, f), r0, r1, s0, s1 in zip(sensitivities, before.residuals, after.residuals, before.starts, after.starts):
        missed = (r0 - r1).reshape(-1) - j @ step
        if f is not None and s0 is not None and s1 is not None:
            missed -= f @ (s1 - s0)
        out.append((j + np.outer(along / length, missed).T, f))
    return out


def relative_change(before: Sequence[FloatArray], after: Sequence[FloatArray]) -> float:
    """Norm of the change of all records (N, S) over their norm before [1]."""
    change = sum(float(np.sum((b - a) ** 2)) for a, b in zip(before, after))
    return float(np.sqrt(change / max(sum(float(np.sum(a**2)) for a in before), 1e-300)))


def covariance_of(normal: FloatArray) -> tuple[FloatArray, bool]:
    """Covariance (P, P) [unit of x, squared]: pseudoinverse of the normal matrix; whether all parameters are determined."""
    scale = np.sqrt(np.diagonal(normal))
    determined = bool(np.all(scale > 0.0))
    safe = np.where(scale > 0.0, scale, 1.0)
    values, vectors = np.linalg.eigh(normal / np.outer(safe, safe))
    determined = determined and bool(values[0] > 1e-13 * values[-1])
    kept = np.where(values > 1e-13 * values[-1], values, np.inf)
    covariance = (vectors / kept) @ vectors.T / np.outer(safe, safe)
    return np.asarray(covariance), determined
