"""Motion under forces that are nonlinear or vary in time, on a grid finer than the samples.

    q'' + (C + G) q' + K q = F u(t) + a(t, q, q', u)

The linear trajectory x_l under the held drive is exact (matrix exponential).  The deviation d from it is integrated,

    d' = A d + (0, a(t, x_l + d, u))

by Lawson-RK4 (Lawson, SIAM J. Numer. Anal. 4 (1967) 372) with the exact exponential of A and ``SUBSTEPS`` steps per sample.
This avoids cancellation, and the jumps and kinks of the held drive stay in the exact part.  The nonlinear response in volts,
r = (V, D) d + (sense effects), is smooth between samples; ``readout_filter`` takes it as the polynomial through the
``SUBSTEPS`` + 1 values of each sample interval.

If a force is so weak that its first order suffices, it is summed along the linear trajectory, which all such forces share
(``first_order``).

Shapes: N samples, M = (N - 1) SUBSTEPS + 1 grid points, n coordinates, D drives, S senses.  A state (2n,) is (q, q') with q
in V s and q' in V.  H >= n is the size to which the compiled loops pad q and q'.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.linalg import expm

from ...arrays import FloatArray, IntArray
from ...device.force_law import Laws, acting_forces
from ...device.mechanics import Mechanics, state_matrix
from ...errors import ConfigError
from ..instrument import Hold
from .compiled import compiled_deviation, compiled_linear_states

SUBSTEPS = 4

#: Force functions of effects, and their parameters (k,).
Forces = Sequence[tuple[Any, FloatArray]]


@dataclass(frozen=True, eq=False)
class Steps:
    """Exact propagators over half a substep, in the padded layout (scale q, 0, q', 0) of the compiled loops.

    Parameters
    ----------
    step_s, substeps : time between samples [s], substeps per sample.
    sloped : whether the drive is linear between samples (first-order hold).
    half_size : H.
    scale : factor of q in a padded state [rad/s].
    factors : (2n,) scale for q, 1 for q'.
    index : (2n,) place of each of (q, q') in a padded state.
    half, held, ramp : (2H, 2H), (D, 2H), (D, 2H) response to a state, a drive and the slope of a drive, transposed.
    """

    step_s: float
    substeps: int
    sloped: bool
    half_size: int
    scale: float
    factors: FloatArray
    index: IntArray
    half: FloatArray
    held: FloatArray
    ramp: FloatArray

    @property
    def coordinates(self) -> int:
        """Number n of coordinates."""
        return self.factors.size // 2

    def padded(self, rows: FloatArray) -> FloatArray:
        """Rows (r, 2n) in the padded layout (r, 2H), units unchanged."""
        out = np.zeros((rows.shape[0], 2 * self.half_size))
        out[:, self.index] = rows
        return out

    def padded_start(self, start: FloatArray | None) -> FloatArray:
        """A state (2n,) [V s, V], scaled and padded (2H,) [V]; ``None`` is rest."""
        return self.padded((np.zeros_like(self.factors) if start is None else start * self.factors)[None])[0]


def steps_of(mechanics: Mechanics, step_s: float, hold: Hold, substeps: int, own: int | None = None) -> Steps:
    """Exact propagators of ``mechanics`` (a batch of one) for drive samples ``step_s`` [s] apart, per half substep.

    ``own`` : only of so many first coordinates, which do not couple to the others; by default of all.
    """
    whole, drives = mechanics.drive.shape[1:]
    n = whole if own is None else own
    kept = np.concatenate([np.arange(n), whole + np.arange(n)])
    a = state_matrix(mechanics)[0][np.ix_(kept, kept)]
    # In (scale q, q') the matrix is balanced, so its exponential loses no digits.
    scale = float(np.sqrt(np.mean(np.diagonal(mechanics.stiffness[0])[:n])))
    factors = np.concatenate([np.full(n, scale), np.ones(n)])
    augmented = np.zeros((2 * n + 2 * drives, 2 * n + 2 * drives))
    augmented[: 2 * n, : 2 * n] = a * factors[:, None] / factors
    augmented[n : 2 * n, 2 * n : 2 * n + drives] = mechanics.drive[0, :n]
    augmented[2 * n : 2 * n + drives, 2 * n + drives :] = np.eye(drives)
    propagator = expm(augmented * (0.5 * step_s / substeps))
    # The loops add four sums at a time.  Three coordinates take 1.1 times as long in four places as in three, and share code.
    half_size = n + n % 2
    index = np.concatenate([np.arange(n), half_size + np.arange(n)])
    rows = np.zeros((2 * n + 2 * drives, 2 * half_size))
    rows[:, index] = propagator[: 2 * n].T
    half = np.zeros((2 * half_size, 2 * half_size))
    half[index] = rows[: 2 * n]
    held, ramp = rows[2 * n : 2 * n + drives].copy(), rows[2 * n + drives :].copy()
    return Steps(step_s, substeps, hold != "zoh", half_size, scale, factors, index, half, held, ramp)


def trajectory(
    mechanics: Mechanics,
    forces: Forces,
    laws: Laws,
    drive: FloatArray,
    step_s: float,
    hold: Hold,
    start: FloatArray | None,
    substeps: int = SUBSTEPS,
    reads: FloatArray | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Linear trajectory and deviation from it, both (M, 2n) [V s, V].

    Parameters
    ----------
    mechanics : a batch of one.
    forces : force functions and their parameters.
    laws : quantities that force functions may use.
    drive : (N, D) volts after the drive stage.
    step_s : time between samples [s].
    hold : "zoh" or "foh".
    start : state (2n,) at the first sample; ``None`` is rest.
    substeps : per sample.
    reads : (S, 2n) pick-off volts from a state; with it the result is (0, S) and (M, S), the deviation in volts only.

    Raises
    ------
    ConfigError : a motion that diverges.
    """
    whole = mechanics.drive.shape[1]
    own = whole if reads is None else _moved_coordinates(mechanics, reads, start)
    kept = np.concatenate([np.arange(own), whole + np.arange(own)])
    steps = steps_of(mechanics, step_s, hold, substeps, own)
    appended, beside = appended_half(mechanics, steps)
    points = (drive.shape[0] - 1) * substeps + 1
    taps = steps.padded((np.eye(steps.factors.size) if reads is None else reads[:, kept]) / steps.factors)
    linear = np.empty((points if reads is None else 0, taps.shape[0]))
    deviation = np.empty((points, taps.shape[0]))
    compiled_deviation(steps.half_size, beside.shape[0] // 2)(
        (0,) * steps.half_size,
        (0,) * (beside.shape[0] // 2),
        *acting_forces(forces),
        laws,
        steps.half,
        steps.held,
        steps.ramp,
        beside,
        1.0 / steps.scale,
        step_s,
        substeps,
        steps.coordinates,
        appended,
        np.ascontiguousarray(drive),
        steps.sloped,
        steps.padded_start(None if start is None else start[kept]),
        taps,
        linear,
        deviation,
    )
    if not np.isfinite(deviation[-1]).all():
        raise ConfigError("the motion diverges", next_step="check the size and sign of the nonlinear effects")
    return linear, deviation


def _moved_coordinates(mechanics: Mechanics, reads: FloatArray, start: FloatArray | None) -> int:
    """Number of first coordinates from which the others can be integrated apart: forces alone move these, and none is read.

    All of them where that would not save a pair of places (``Steps.half_size``).
    """
    n = mechanics.drive.shape[1]
    for own in range(1, n):
        both = np.tile(np.arange(n) >= own, 2)
        if forces_alone_move(mechanics, own, reads) and (start is None or not np.any(start[both])):
            return own if own + own % 2 < n + n % 2 else n
    return n


def forces_alone_move(mechanics: Mechanics, own: int, reads: FloatArray) -> bool:
    """Whether all but the ``own`` first coordinates (of a batch of one) move by forces alone, and ``reads`` (S, 2n) skip them."""
    apart = np.arange(mechanics.drive.shape[1]) >= own
    across = apart[:, None] != apart
    matrices = (mechanics.stiffness[0], mechanics.damping[0], mechanics.gyroscopic[0])
    return not (
        any(np.any(matrix[across]) for matrix in matrices)
        or np.any(mechanics.drive[0][apart])
        or np.any(reads[:, np.tile(apart, 2)])
    )


def appended_half(mechanics: Mechanics, steps: Steps) -> tuple[int, FloatArray]:
    """Number m of coordinates appended to those of ``steps``, and their propagator over half a substep.

    It is transposed and padded as ``Steps.half``, (2W, 2W) with W >= m even, in the units (scale q, q') of ``steps``.
    """
    n, own = mechanics.stiffness.shape[1], steps.coordinates
    m = n - own
    wide = m + m % 2
    place = np.concatenate([np.arange(own, n), n + np.arange(own, n)])
    factors = np.concatenate([np.full(m, steps.scale), np.ones(m)])
    a = state_matrix(mechanics)[0][np.ix_(place, place)] * factors[:, None] / factors
    index = np.concatenate([np.arange(m), wide + np.arange(m)])
    half = np.zeros((2 * wide, 2 * wide))
    half[np.ix_(index, index)] = expm(a * (0.5 * steps.step_s / steps.substeps)).T if m else 0.0
    return m, half


def between_samples(drive: FloatArray, substeps: int, sloped: bool) -> FloatArray:
    """Drives (N, D) [V] at the grid points (M, D): held, or linear between samples if ``sloped``.

    A held drive that jumps at a sample has its new value there.
    """
    held = np.repeat(drive, substeps, axis=0)[: (drive.shape[0] - 1) * substeps + 1]
    if not sloped:
        return held
    rise = np.repeat(np.diff(drive, axis=0), substeps, axis=0) * (np.arange(held.shape[0] - 1) % substeps)[:, None]
    held[:-1] += rise / substeps
    return held


@dataclass(frozen=True, eq=False)
class Motion:
    """A linear trajectory: its steps, drive (N, D) [V], and padded states (2M - 1, 2H) [V] at every half substep."""

    steps: Steps
    drive: FloatArray
    states: FloatArray

    @cached_property
    def state(self) -> FloatArray:
        """(M, 2n) states at the grid points [V s, V]."""
        return np.asarray(self.states[::2, self.steps.index] / self.steps.factors)


def linear_motion(
    mechanics: Mechanics, drive: FloatArray, step_s: float, hold: Hold, start: FloatArray | None, substeps: int
) -> Motion:
    """The linear trajectory under ``drive`` (N, D) [V] from ``start`` (2n,); arguments as in ``trajectory``."""
    steps = steps_of(mechanics, step_s, hold, substeps)
    u = np.ascontiguousarray(drive)
    states = np.empty((2 * (u.shape[0] - 1) * substeps + 1, 2 * steps.half_size))
    compiled_linear_states(steps.half_size)(
        (0,) * steps.half_size,
        steps.half,
        steps.held,
        steps.ramp,
        step_s,
        substeps,
        u,
        steps.sloped,
        steps.padded_start(start),
        states,
    )
    return Motion(steps, u, states)
