"""Section 5 of the paper recomputed: how off-diagonal damping changes theta and the motion of the modes.

    q'' + C q' + diag(omega1^2, omega2^2) q = F,   S = q',   theta = 0

Table 1: over all positive semidefinite C with eigenvalues in [0, delta], the largest error of theta read from the first
Markov parameters 2 Re R_i of the two block-diagonalised modes, by their left and right singular vectors.
Table 2: each mode moves on an ellipse; its major axis lies epsilon off the stiffness axis, a/a' is their ratio.

Units: hertz, 1/s, degrees.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from ..arrays import ComplexArray, FloatArray
from ..device.mechanics import Mechanics, modes_of

TAU = 2.0 * np.pi


@dataclass(frozen=True, eq=False)
class RockingMotion:
    """Table 2, one row: split [Hz], c12 [1/s], epsilon (2,) [deg] and ratio a/a' (2,) [1] of each mode's ellipse."""

    split_hz: float
    c12_per_s: float
    tilt_deg: FloatArray
    axis_ratio: FloatArray


def rocking_residues(f_hz: FloatArray, damping: FloatArray) -> ComplexArray:
    """R (B, 2, 2, 2) [1] of q'/F for C (B, 2, 2) [1/s] and stiffness axes on the coordinates, f (2,) [Hz]."""
    batch = damping.shape[0]
    zero = np.zeros((batch, 2, 2))
    identity = np.broadcast_to(np.eye(2), zero.shape)
    stiffness = np.broadcast_to(np.diag((TAU * f_hz) ** 2), zero.shape)
    return modes_of(Mechanics(damping, zero, stiffness, identity, identity, zero)).residues


def axis_errors_deg(f_hz: FloatArray, damping: FloatArray) -> FloatArray:
    """|theta| (B, 4) [deg], in [0, 90], from u1, v1, u2, v2 where the truth is zero; f (2,) [Hz], C (B, 2, 2) [1/s]."""
    u, _, vt = np.linalg.svd(2.0 * rocking_residues(f_hz, damping).real)
    first, second = np.abs(u[..., 0]), np.abs(vt[..., 0, :])
    across = np.stack([first[:, 0, 1], second[:, 0, 1], first[:, 1, 0], second[:, 1, 0]], axis=1)
    along = np.stack([first[:, 0, 0], second[:, 0, 0], first[:, 1, 1], second[:, 1, 1]], axis=1)
    return np.asarray(np.rad2deg(np.arctan2(across, along)))


def _damping(low: FloatArray, high: FloatArray, axis: FloatArray) -> FloatArray:
    """C (B, 2, 2) with the eigenvalues low, high [1/s] and the axis of ``high`` at ``axis`` [rad]."""
    c, s = np.cos(axis), np.sin(axis)
    along = np.stack([np.stack([c * c, c * s], -1), np.stack([c * s, s * s], -1)], -2)
    return np.asarray(low[:, None, None] * np.eye(2) + (high - low)[:, None, None] * along)


def _local_maximum(height: Callable[[FloatArray], float], start: FloatArray) -> float:
    """The local maximum next to ``start``; the function may have a kink where two estimates change order."""

    def depth(x: FloatArray, *_: object) -> float:
        return -height(x)

    return -float(minimize(depth, start, method="Nelder-Mead", tol=1e-7).fun)


def largest_axis_error_deg(f_hz: FloatArray, bound_per_s: float) -> float:
    """Delta theta of Table 1: the maximum over 0 <= C <= delta I.

    Parameters
    ----------
    f_hz : (2,) stiffness frequencies, ascending and not equal [Hz].
    bound_per_s : delta [1/s].
    """
    if bound_per_s == 0.0:
        return 0.0
    share, axis = np.linspace(0.0, 1.0, 9), np.linspace(0.0, np.pi, 72, endpoint=False)
    low, high, angle = (g.ravel() for g in np.meshgrid(share, share, axis, indexing="ij"))

    def error(points: FloatArray) -> FloatArray:
        inside = np.clip(points[:, :2], 0.0, 1.0) * bound_per_s
        return axis_errors_deg(f_hz, _damping(inside[:, 0], inside[:, 1], points[:, 2])).max(axis=1)

    grid = np.stack([low, high, angle], axis=1)
    values = error(grid)
    found = [_local_maximum(lambda x: float(error(x[None])[0]), grid[k]) for k in np.argsort(-values)[:4]]
    return max(float(values.max()), *found)


def rocking_motion(f1_hz: float, split_hz: float, zeta: FloatArray, c12_per_s: float) -> RockingMotion:
    """Ellipses of both rocking modes: c_ii = 2 zeta_i omega_i, eq. (20), (22), (23); zeta (2,), f1, split [Hz], c12 [1/s].

    The motion of mode i is Re(x e^{jwt}), x complex: the singular values of [Re x, Im x] are the half axes.
    """
    f_hz = np.array([f1_hz, f1_hz + split_hz])
    c11, c22 = 2.0 * zeta * TAU * f_hz
    residues = rocking_residues(f_hz, np.array([[[c11, c12_per_s], [c12_per_s, c22]]]))[0]
    shapes = np.linalg.svd(residues)[0][:, :, 0]
    u, axes, _ = np.linalg.svd(np.stack([shapes.real, shapes.imag], axis=-1))
    major = np.abs(u[:, :, 0])
    tilt = np.rad2deg(np.arctan2([major[0, 1], major[1, 0]], [major[0, 0], major[1, 1]]))
    return RockingMotion(split_hz, c12_per_s, np.asarray(tilt), np.asarray(axes[:, 0] / np.maximum(axes[:, 1], 1e-300)))


def largest_damping_eigenvalue(f_hz: FloatArray, zeta: FloatArray) -> float:
    """delta [1/s] of (21): the trace 2 zeta_1 omega_1 + 2 zeta_2 omega_2, reached at c12 = sqrt(c11 c22); f, zeta (2,)."""
    return float(np.sum(2.0 * zeta * TAU * f_hz))
