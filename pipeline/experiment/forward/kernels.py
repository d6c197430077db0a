"""Loops over the samples of a record: the exact linear motion, and the deviation from it that forces cause.

``compiled`` compiles these functions for a given number of coordinates.  The length of the tuple ``shape`` is H: the
compiler then knows the length of the loops over a state, which makes them several times faster, and unlike a closure the
compiled function can be cached.

A state is (scale q, 0, q', 0) with q and q' padded to H values each, so that both have the unit V.  E is the exact propagator
over half a substep h/2.  All matrices are transposed.

Shapes: N samples, M = (N - 1) substeps + 1 grid points, n coordinates (n <= H), D drives, T linear combinations of a state
(``taps``).  Units: seconds, volts.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from ...arrays import FloatArray
from ...device.force_law import Laws

#: Places for force effects in a compiled loop; the fewest that suffice are used.  Measured on a record with two forces: 6 ms with
#: 8 places, 16 ms with 16, and also 11 ms with 4.
FORCE_PLACES = (8, 16)
#: Most force effects that can act at once.
MOST_FORCES = FORCE_PLACES[-1]


@njit(inline="always")
def _summed(size: int, transposed: FloatArray, offset: int, rows: int, x: FloatArray, out: FloatArray) -> None:
    """out = x[:rows] @ transposed[offset : offset + rows]; two sums at a time stay in registers."""
    for i in range(0, size, 2):
        s0, s1 = 0.0, 0.0
        for j in range(rows):
            s0 += transposed[offset + j, i] * x[j]
            s1 += transposed[offset + j, i + 1] * x[j]
        out[i], out[i + 1] = s0, s1


@njit(inline="always")
def _propagate(shape: tuple[int, ...], transposed: FloatArray, x: FloatArray, out: FloatArray) -> None:
    _summed(2 * len(shape), transposed, 0, 2 * len(shape), x, out)


@njit(inline="always")
def _propagate_velocity(shape: tuple[int, ...], transposed: FloatArray, a: FloatArray, out: FloatArray) -> None:
    _summed(2 * len(shape), transposed, len(shape), len(shape), a, out)


@njit(inline="always")
def _dot(shape: tuple[int, ...], taps: FloatArray, tap: int, x: FloatArray) -> float:
    total = 0.0
    for i in range(2 * len(shape)):
        total += taps[tap, i] * x[i]
    return total


def deviation_from_linear(
    shape: tuple[int, ...],
    forces: Any,
    count: int,
    p: Any,
    laws: Laws,
    half: FloatArray,
    held: FloatArray,
    ramp: FloatArray,
    scale: float,
    step_s: float,
    substeps: int,
    n: int,
    drive: FloatArray,
    sloped: bool,
    start: FloatArray,
    taps: FloatArray,
    linear: FloatArray,
    deviation: FloatArray,
) -> None:
    """Integrate d' = A d + (0, a(t, x_l + d, u)) along the linear motion x_l by Lawson-RK4; fill ``linear``, ``deviation``.

    Parameters
    ----------
    shape : tuple of H zeros.
    forces, count, p, laws : force functions (``FORCE_PLACES``, the first ``count`` act), their parameters, and what they use.
    half, held, ramp : (2H, 2H), (D, 2H), (D, 2H) response over half a substep to a state, a drive and the slope of a drive.
    scale, step_s, substeps, n : factor of q in a state [rad/s], time between samples [s], substeps, coordinates.
    drive, sloped : (N, D) [V]; whether the drive is linear between samples (first-order hold).
    start : (2H,) state at the first sample [V].
    taps : (T, 2H).
    linear : (M, T) taps of the linear motion, filled; (0, T) where it is not wanted.
    deviation : (M, T) taps of the deviation, filled.
    """
    half_size = len(shape)
    size = 2 * half_size
    drives = held.shape[0]
    samples = drive.shape[0]
    h = step_s / substeps
    inverse = 1.0 / scale
    q, qd, out, u, slope = np.empty(n), np.empty(n), np.empty(n), np.empty(drives), np.zeros(drives)
    k1, k2, k3 = np.zeros(half_size), np.zeros(half_size), np.zeros(half_size)
    y, e1, e2, w, trial = np.empty(size), np.empty(size), np.empty(size), np.empty(size), np.empty(size)
    middle, after, d, driven = np.empty(size), np.empty(size), np.zeros(size), np.empty(size)
    for i in range(size):
        y[i] = start[i]
    wants_linear = linear.shape[0] > 0
    for tap in range(taps.shape[0]):
        deviation[0, tap] = 0.0
        if wants_linear:
            linear[0, tap] = _dot(shape, taps, tap, y)
    for sample in range(samples - 1):
        for k in range(drives):
            slope[k] = (drive[sample + 1, k] - drive[sample, k]) / step_s if sloped else 0.0
        for sub in range(substeps):
            local = sub * h
            t = laws.elapsed_s + sample * step_s + local
            for i in range(size):
                driven[i] = 0.0
            for k in range(drives):
                u[k] = drive[sample, k] + slope[k] * local
                for i in range(size):
                    driven[i] += held[k, i] * u[k] + ramp[k, i] * slope[k]
            _propagate(shape, half, y, middle)
            for i in range(size):
                middle[i] += driven[i]
            _propagate(shape, half, middle, after)
            for k in range(drives):
                for i in range(size):
                    driven[i] += held[k, i] * slope[k] * (0.5 * h)
            for i in range(size):
                after[i] += driven[i]
            if count > 0:
                for i in range(n):
                    q[i], qd[i], out[i] = (y[i] + d[i]) * inverse, y[half_size + i] + d[half_size + i], 0.0
                for k in range(count):
                    forces[k](t, q, qd, u, p[k], laws, out)
                for i in range(n):
                    k1[i] = out[i]
                _propagate(shape, half, d, e1)
                _propagate_velocity(shape, half, k1, w)
                for i in range(size):
                    trial[i] = middle[i] + e1[i] + 0.5 * h * w[i]
                for k in range(drives):
                    u[k] += slope[k] * 0.5 * h
                for i in range(n):
                    q[i], qd[i], out[i] = trial[i] * inverse, trial[half_size + i], 0.0
                for k in range(count):
                    forces[k](t + 0.5 * h, q, qd, u, p[k], laws, out)
                for i in range(n):
                    k2[i] = out[i]
                    q[i] = (middle[i] + e1[i]) * inverse
                    qd[i] = middle[half_size + i] + e1[half_size + i] + 0.5 * h * k2[i]
                    out[i] = 0.0
                for k in range(count):
                    forces[k](t + 0.5 * h, q, qd, u, p[k], laws, out)
                for i in range(n):
                    k3[i] = out[i]
                _propagate(shape, half, e1, e2)
                _propagate_velocity(shape, half, k3, trial)
                for i in range(size):
                    trial[i] = after[i] + e2[i] + h * trial[i]
                for k in range(drives):
                    u[k] += slope[k] * 0.5 * h
                for i in range(n):
                    q[i], qd[i], out[i] = trial[i] * inverse, trial[half_size + i], 0.0
                for k in range(count):
                    forces[k](t + h, q, qd, u, p[k], laws, out)
                # d <- E^2 d + h/6 (E (E k1 + 2 (k2 + k3)) + k4),  E the exponential of half a substep
                for i in range(n):
                    w[half_size + i] += 2.0 * (k2[i] + k3[i])
                _propagate(shape, half, w, trial)
                for i in range(size):
                    d[i] = e2[i] + h / 6.0 * trial[i]
                for i in range(n):
                    d[half_size + i] += h / 6.0 * out[i]
            point = sample * substeps + sub + 1
            for i in range(size):
                y[i] = after[i]
            for tap in range(taps.shape[0]):
                deviation[point, tap] = _dot(shape, taps, tap, d)
                if wants_linear:
                    linear[point, tap] = _dot(shape, taps, tap, y)


def linear_states(
    shape: tuple[int, ...],
    half: FloatArray,
    held: FloatArray,
    ramp: FloatArray,
    step_s: float,
    substeps: int,
    drive: FloatArray,
    sloped: bool,
    start: FloatArray,
    out: FloatArray,
) -> None:
    """Fill ``out`` (2M - 1, 2H) [V] with the linear motion at every half substep.

    Arguments as in ``deviation_from_linear``.
    """
    size = 2 * len(shape)
    drives = held.shape[0]
    half_s = 0.5 * step_s / substeps
    driven, slope = np.empty(size), np.zeros(drives)
    for i in range(size):
        out[0, i] = start[i]
    row = 0
    for sample in range(drive.shape[0] - 1):
        for k in range(drives):
            slope[k] = (drive[sample + 1, k] - drive[sample, k]) / step_s if sloped else 0.0
        for part in range(2 * substeps):
            for i in range(size):
                driven[i] = 0.0
            for k in range(drives):
                u = drive[sample, k] + slope[k] * (part * half_s)
                for i in range(size):
                    driven[i] += held[k, i] * u + ramp[k, i] * slope[k]
            _propagate(shape, half, out[row], out[row + 1])
            row += 1
            for i in range(size):
                out[row, i] += driven[i]


def first_order_deviation(
    shape: tuple[int, ...],
    forces: Any,
    count: int,
    p: Any,
    laws: Laws,
    half: FloatArray,
    whole: FloatArray,
    scale: float,
    step_s: float,
    substeps: int,
    n: int,
    drive: FloatArray,
    sloped: bool,
    states: FloatArray,
    taps: FloatArray,
    deviation: FloatArray,
) -> None:
    """Fill ``deviation`` (M, T), the taps of the motion [V] that forces cause, to first order in the forces.

    The forces k1, k2, k3 act along the known linear ``states`` (2M - 1, 2H), at the start, middle and end of a substep
    (Simpson's rule):  d <- E^2 d + h/6 (E^2 k1 + 4 E k2 + k3).  ``whole`` is E^2; the other arguments are those of
    ``deviation_from_linear``.
    """
    half_size = len(shape)
    size = 2 * half_size
    drives = drive.shape[1]
    h = step_s / substeps
    inverse = 1.0 / scale
    q, qd, out, u, slope = np.empty(n), np.empty(n), np.empty(n), np.empty(drives), np.zeros(drives)
    impulse, d, before, trial = np.zeros(half_size), np.zeros(size), np.empty(size), np.empty(size)
    for tap in range(taps.shape[0]):
        deviation[0, tap] = 0.0
    for sample in range(drive.shape[0] - 1):
        for k in range(drives):
            slope[k] = (drive[sample + 1, k] - drive[sample, k]) / step_s if sloped else 0.0
        for sub in range(substeps):
            point = sample * substeps + sub
            t = laws.elapsed_s + sample * step_s + sub * h
            for node in range(3):
                # The forces at the end of the last substep are reused, unless a held drive has jumped since.
                if node > 0 or sub == 0:
                    for i in range(n):
                        q[i], qd[i] = states[2 * point + node, i] * inverse, states[2 * point + node, half_size + i]
                        out[i] = 0.0
                    for k in range(drives):
                        u[k] = drive[sample, k] + slope[k] * (sub + 0.5 * node) * h
                    for k in range(count):
                        forces[k](t + 0.5 * node * h, q, qd, u, p[k], laws, out)
                if node == 0:
                    for i in range(size):
                        before[i] = d[i]
                    for i in range(n):
                        before[half_size + i] += h / 6.0 * out[i]
                    _propagate(shape, whole, before, d)
                elif node == 1:
                    for i in range(n):
                        impulse[i] = h / 1.5 * out[i]
                    _propagate_velocity(shape, half, impulse, trial)
                    for i in range(size):
                        d[i] += trial[i]
                else:
                    for i in range(n):
                        d[half_size + i] += h / 6.0 * out[i]
            for tap in range(taps.shape[0]):
                deviation[point + 1, tap] = _dot(shape, taps, tap, d)
