"""Maximum likelihood of plant "gyro" with off-diagonal damping, in the band, with exact transients.

    x^ = argmin chi2(x) by Levenberg-Marquardt on the compressed likelihood, expanded again until the poles converge
    covariance = (J^T J)^-1 at x^

The step is limited by the radius of the expansion, and the compiled Jacobian is as cheap as a residual; the loop of the general
fit (``general.gauss_newton``) avoids computing Jacobians instead, so the two share no damping rule.

x: cartesian parameters (12,) of ``pipeline.device.gyro``, or (14,) with the mismatches of ``mismatch``; sigma (S,) [V].
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from scipy.linalg.lapack import dgeqrf, dgesdd, dposv, dtrtri

from ...arrays import ComplexArray, FloatArray
from ...device.gyro import M_D, M_S, cartesian_modes
from .compressed import BandData, Compressed, compress
from .likelihood import allowed, jacobian_rows, residual_rows
from .mismatch import MismatchPrior, with_mismatch

#: |h| up to which the third-order expansion is exact to 2e-8 of the response [rad/s].
_DISC = 0.03
_EXPANSIONS = 12
_ITERATIONS = 60
#: Smallest element of the diagonal of a triangle, relative to the largest, that counts as regular.
_SINGULAR = 1e-10
Matrix = TypeVar("Matrix", FloatArray, ComplexArray)


@dataclass(frozen=True, eq=False)
class Fit:
    """The maximum-likelihood point of one device.

    Parameters
    ----------
    x, covariance : parameters (P,), P = 12 or 14, and their covariance (P, P).
    chi2, dof : in the band.
    likelihood : the compressed likelihood around the poles of ``x``.
    converged : false if the poles or the parameters did not converge.
    """

    x: FloatArray
    covariance: FloatArray
    chi2: float
    dof: int
    likelihood: Compressed
    converged: bool


def start_from_modes(poles: ComplexArray, residues: ComplexArray) -> FloatArray:
    """Cartesian parameters (12,) from three identified modes of the device without the anti-alias filter.

    The rocking pair forms one matrix pole  L = (p1 R1 + p2 R2)(R1 + R2)^-1, a solvent of  L^2 + C L + K = 0, so with
    L = A + iB:  C = -(A B + B A) B^-1,  K = B^2 - A^2 - C A.  Unlike the modes, L is regular where they coalesce.

    Parameters
    ----------
    poles : p1, p2 of the rocking pair and p3 of the up-down mode (3,) [rad/s].
    residues : (3, 2, 2) [1/s] of H from drive volts to pick-off volts.
    """
    u, size, vt, _ = dgesdd(2.0 * residues[2].real)
    mean_s, mean_d = (u[0, 0] + u[1, 0]) / 2.0, (vt[0, 0] + vt[0, 1]) / 2.0
    k_s, k_d = u[:, 0] / mean_s, vt[0] / mean_d
    g_z = size[0] * mean_s * mean_d
    s, d = (k_s[1] - k_s[0]) / 2.0, (k_d[1] - k_d[0]) / 2.0
    first, second = _inverse(k_s[:, None] * M_S) @ residues[:2] @ _inverse(M_D * k_d)
    both = first + second
    g_r = (both[0, 0] + both[1, 1]).real
    solvent = (poles[0] * first + poles[1] * second) @ _inverse(both)
    a, b = solvent.real, solvent.imag
    damping = -(a @ b + b @ a) @ _inverse(b)
    stiffness = b @ b - a @ a - damping @ a
    (k_xx, k_xy), (k_yx, k_yy) = stiffness.tolist()
    (c_xx, c_xy), (c_yx, c_yy) = damping.tolist()
    square = (k_xx + k_yy) / 2.0
    omega0 = math.sqrt(square) if square > 0.0 else math.nan
    c0 = max((c_xx + c_yy) / 2.0, 1e-3)
    d_c, d_s = (c_xx - c_yy) / 2.0, (c_xy + c_yx) / 2.0
    shrink = min(1.0, 0.95 * c0 / max(math.hypot(d_c, d_s), 1e-12))
    return np.array(
        [
            omega0,
            (k_xx - k_yy) / (2.0 * omega0),
            (k_xy + k_yx) / (2.0 * omega0),
            c0,
            d_c * shrink,
            d_s * shrink,
            abs(poles[2]),
            max(-2.0 * poles[2].real, 1e-3),
            math.log(max(abs(g_r), 1e-12)),
            math.log(max(abs(g_z), 1e-12)),
            min(max(s, -0.9), 0.9),
            min(max(d, -0.9), 0.9),
        ]
    )


def _inverse(matrix: Matrix) -> Matrix:
    """Inverse of a matrix (2, 2), in a third of the time of the general one; LinAlgError as there."""
    (a, b), (c, d) = matrix.tolist()
    determinant = a * d - b * c
    if determinant == 0.0:
        raise np.linalg.LinAlgError("singular matrix")
    return np.array([[d / determinant, -b / determinant], [-c / determinant, a / determinant]])


def modes_at(x: FloatArray) -> tuple[ComplexArray, ComplexArray]:
    """Poles (3,) and residues (3, 2, 2) [rad/s] of parameters x (12,) or (14,)."""
    poles, residues = np.empty(3, dtype=np.complex128), np.empty((3, 2, 2), dtype=np.complex128)
    cartesian_modes(x, poles, residues)
    return poles, residues


def _descend(start: FloatArray, likelihood: Compressed, reach: float) -> tuple[FloatArray, bool, float]:
    """Levenberg-Marquardt from ``start`` (12,) within ``reach`` [rad/s] of the expansion.

    Returns x (12,), whether it converged, and the largest shift |h| of a pole [rad/s].
    """
    x = start
    arrays = likelihood.arrays
    r, shift = residual_rows(x, *arrays)
    chi2, damping = float(r @ r), 1e-6
    for _ in range(_ITERATIONS):
        j = jacobian_rows(x, *arrays)
        gram, slope = j.T @ j, j.T @ r
        scale = np.sqrt(np.diag(gram)) + 1e-300
        unit, unit_slope = gram / (scale[:, None] * scale), slope / scale
        improved = False
        for _ in range(12):
            damped = unit.copy()
            damped.flat[:: x.size + 1] += damping
            # A matrix that is singular to rounding, or not finite, needs more damping.
            _, step, fault = dposv(damped, unit_slope, overwrite_a=True)
            step /= scale
            trial = x + step
            if fault == 0 and allowed(trial):
                moved, shift_trial = residual_rows(trial, *arrays)
                if shift_trial <= max(reach, shift) and float(moved @ moved) <= chi2:
                    improved = True
                    break
            damping = max(damping * 10.0, 1e-8)
        # A step of a thousandth of a standard deviation counts as convergence.
        small = float(step @ gram @ step) < 1e-6
        if not improved:
            return x, small, shift
        decrease = chi2 - float(moved @ moved)
        x, r, chi2, shift = trial, moved, float(moved @ moved), shift_trial
        damping = max(damping * 0.1, 1e-12)
        if small or decrease < 1e-9:
            return x, True, shift
    return x, False, shift


def _covariance(j: FloatArray) -> FloatArray:
    """(J^T J)^-1 (P, P) of J (n, P), by QR in units of each column's norm: the eigenvalues span twelve decades."""
    scale = np.linalg.norm(j, axis=0)
    # LAPACK itself: numpy takes twice as long for a matrix of this size.
    factors, _, _, _ = dgeqrf(j / scale, overwrite_a=True)
    triangle = np.triu(factors[: j.shape[1]])
    size = np.abs(triangle.diagonal())
    if size.min() > _SINGULAR * size.max():
        inverse, _ = dtrtri(triangle)
    else:
        inverse = np.linalg.pinv(triangle)
    return np.asarray((inverse @ inverse.T) / np.outer(scale, scale))


def information_covariance(
    records: Sequence[BandData], sigma_v: FloatArray, x: FloatArray, prior: MismatchPrior | None = None
) -> FloatArray:
    """Cramer-Rao bound (P, P): inverse Fisher information of ``records`` and ``prior`` at ``x`` (P,); sigma (S,) [V]."""
    likelihood = compress(records, sigma_v, modes_at(x)[0], prior)
    return _covariance(jacobian_rows(x, *likelihood.arrays))


def maximise(
    records: Sequence[BandData], sigma_v: FloatArray, start: FloatArray, prior: MismatchPrior | None = None
) -> Fit:
    """The maximum of the likelihood from ``start`` (12,) or (14,).

    Parameters
    ----------
    records : fit records of one device in their band.
    sigma_v : (S,) noise [V].
    start : cartesian parameters, with mismatches or without.
    prior : of the mismatches, which are then fitted too; ``None``: there are none.
    """
    x, converged = start[:12] if prior is None else with_mismatch(start, prior), False
    for _ in range(_EXPANSIONS):
        likelihood = compress(records, sigma_v, modes_at(x)[0], prior)
        x, minimum, shift = _descend(x, likelihood, 10.0 * _DISC)
        if minimum and shift < _DISC:
            converged = True
            break
    r, _ = residual_rows(x, *likelihood.arrays)
    covariance = _covariance(jacobian_rows(x, *likelihood.arrays))
    chi2 = float(r @ r + likelihood.rest_chi2.sum())
    return Fit(x, covariance, chi2, likelihood.rows - x.size, likelihood, converged)
