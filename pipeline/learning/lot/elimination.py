"""Exact covariance of a lot, by eliminating one level after the other.

    V = D + sum over levels Z v Z',      D the covariance of single devices (measurement, and parts of the level "device")
    F = D^(-1/2) [Z sqrt(v), X],         C = I + F_z' F_z of one wafer,   F_a' F_a - F_a' F_z C^-1 F_z' F_a goes up
    ln det V = sum ln det D + sum ln det C over wafers, lots and the whole

so a likelihood costs O(n q R^2), and no matrix is larger than the devices of one wafer.  From the top down, the same factors
give the best predictions u of the normals, P y, and the variances that the derivatives need:

    P = V^-1 - V^-1 X (X' V^-1 X)^-1 X' V^-1,         d ln L / d ln v_c = 1/2 (|u_c|^2 - r_c + tr Var(u_c | y))

Shapes: n devices, W wafers, L lots, q quantities, R columns, B right-hand sides.
Source: Henderson, Biometrics 31 (1975) 423; Searle, Casella, McCulloch, Variance Components (1992), ch. 6 to 8.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ...arrays import FloatArray, IntArray
from .design import LotDesign


@dataclass(frozen=True, eq=False)
class Stage:
    """One eliminated level of U units: C^-1 (U, r, r), K = C^-1 F_z' F_a (U, r, a), and the unit above each."""

    inverse: FloatArray
    gain: FloatArray
    above: IntArray


@dataclass(frozen=True, eq=False)
class LotFactor:
    """The factors of V at given variances.

    Parameters
    ----------
    design, variances : of the model, and v (C,).
    white : (n, q, q) D^(-1/2).
    columns : (W, k q, R) F.
    stages : wafer, lot, all.
    fixed_inverse : (p, p) covariance of the coefficients of the fixed columns.
    log_det, log_det_fixed : of V and of X' V^-1 X.
    """

    design: LotDesign
    variances: FloatArray
    white: FloatArray
    columns: FloatArray
    stages: tuple[Stage, Stage, Stage]
    fixed_inverse: FloatArray
    log_det: float
    log_det_fixed: float


@dataclass(frozen=True, eq=False)
class LotSolution:
    """Predictions for B right-hand sides.

    Parameters
    ----------
    residual : (W, k q, B) D^(-1/2) (y - everything predicted), which is D^(1/2) P y.
    normals : of the wafers (W, r, B), of the lots (L, r, B), of the whole (1, r, B).
    coefficients : (p, B) of the fixed columns.
    quadratic : (B,) y' P y.
    """

    residual: FloatArray
    normals: tuple[FloatArray, FloatArray, FloatArray]
    coefficients: FloatArray
    quadratic: FloatArray


def factorised(design: LotDesign, variances: FloatArray) -> LotFactor:
    """Factors of V.

    Raises
    ------
    numpy.linalg.LinAlgError : a device has no variance in some direction, or a fixed column is a combination of others.
    """
    d = design.noise + np.tensordot(variances[design.own_part], design.own, axes=1)
    root = np.linalg.cholesky(d)
    white = np.linalg.inv(root)
    log_det = 2.0 * float(np.sum(np.log(np.einsum("nii->ni", root))))
    scale = np.where(design.part >= 0, np.sqrt(variances[design.part]), 1.0)
    columns = design.padded(white @ (design.columns * scale))
    gram = columns.transpose(0, 2, 1) @ columns
    a, b, c = design.ends
    wafer, gram, one = _eliminated(gram, a, design.lot_of)
    lot, gram, two = _eliminated(gram, b - a, np.zeros(len(gram), dtype=np.int64))
    whole, gram, three = _eliminated(gram, c - b, np.zeros(len(gram), dtype=np.int64))
    top = np.linalg.cholesky(gram[0])
    back = np.linalg.inv(top)
    return LotFactor(
        design=design,
        variances=variances,
        white=white,
        columns=columns,
        stages=(wafer, lot, whole),
        fixed_inverse=back.T @ back,
        log_det=log_det + one + two + three,
        log_det_fixed=2.0 * float(np.sum(np.log(np.diag(top)))),
    )


def _eliminated(gram: FloatArray, r: int, above: IntArray) -> tuple[Stage, FloatArray, float]:
    """Stage of the first r columns, the Gram matrices of the units above, and ln det C."""
    units, total = len(gram), int(above.max()) + 1
    c = np.eye(r) + gram[:, :r, :r]
    root = np.linalg.cholesky(c) if r else c
    back = np.linalg.inv(root) if r else c
    inverse = back.transpose(0, 2, 1) @ back
    gain = inverse @ gram[:, :r, r:]
    left = gram[:, r:, r:] - gram[:, r:, :r] @ gain
    higher = np.zeros((total, *left.shape[1:]))
    np.add.at(higher, above, left)
    log_det = 2.0 * float(np.sum(np.log(np.einsum("uii->ui", root)))) if r else 0.0
    return Stage(inverse, gain, above), higher, log_det if units else 0.0


def solved(factor: LotFactor, values: FloatArray) -> LotSolution:
    """Predictions for the right-hand sides ``values`` (n, q, B), zero where a quantity was not seen."""
    design = factor.design
    y = design.padded(factor.white @ (values * design.seen[..., None]))
    right = factor.columns.transpose(0, 2, 1) @ y
    squares = np.einsum("wrb,wrb->b", y, y)
    own: list[FloatArray] = []
    for stage in factor.stages:
        r = stage.inverse.shape[1]
        u = stage.inverse @ right[:, :r]
        squares = squares - np.einsum("urb,urb->b", right[:, :r], u)
        left = right[:, r:] - stage.gain.transpose(0, 2, 1) @ right[:, :r]
        right = np.zeros((int(stage.above.max()) + 1, *left.shape[1:]))
        np.add.at(right, stage.above, left)
        own.append(u)
    coefficients = factor.fixed_inverse @ right[0]
    quadratic = squares - np.einsum("pb,pb->b", right[0], coefficients)
    known = coefficients[None]
    normals: list[FloatArray] = []
    for stage, u in zip(reversed(factor.stages), reversed(own)):
        # The columns above a level stand in the order lot, all, fixed.
        below = known[stage.above]
        exact = u - stage.gain @ below
        normals.insert(0, exact)
        known = np.concatenate([exact, below], axis=1)
    residual = y - factor.columns @ known
    return LotSolution(residual, (normals[0], normals[1], normals[2]), coefficients, quadratic)


def posterior_covariance(factor: LotFactor) -> tuple[FloatArray, ...]:
    """Covariances given y of all columns that act on one unit: (W, R, R), then those of lots and of the whole, and of X."""
    known = factor.fixed_inverse[None]
    found = [known]
    for stage in reversed(factor.stages):
        above = known[stage.above]
        cross = -stage.gain @ above
        own = stage.inverse - cross @ stage.gain.transpose(0, 2, 1)
        known = np.block([[own, cross], [cross.transpose(0, 2, 1), above]])
        found.insert(0, known)
    return tuple(found)


def log_likelihood(factor: LotFactor, quadratic: float, restricted: bool = True) -> float:
    """Restricted (or full) log likelihood; y' P y is ``quadratic``.

    The restricted one leaves out ln det X'X / 2, which depends on no variance, as nlme and statsmodels do.
    """
    design = factor.design
    dof = design.rows - (design.fixed if restricted else 0)
    value = dof * math.log(2.0 * math.pi) + factor.log_det + quadratic
    if restricted:
        value += factor.log_det_fixed
    return -0.5 * value


def device_covariance(factor: LotFactor, covariance: FloatArray) -> FloatArray:
    """(n, q, q) D^(1/2) P_ii D^(1/2) of each device, ``covariance`` (W, R, R) from :func:`posterior_covariance`."""
    w, k = factor.design.slots.shape
    q = factor.design.seen.shape[1]
    spread = factor.columns @ covariance
    mine = spread.reshape(w, k, q, -1)
    blocks = np.eye(q) - mine @ factor.columns.reshape(w, k, q, -1).transpose(0, 1, 3, 2)
    there = factor.design.slots >= 0
    result = np.empty((len(factor.design.seen), q, q))
    result[factor.design.slots[there]] = blocks[there]
    return result
