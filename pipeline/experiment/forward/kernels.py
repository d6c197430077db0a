"""Loops over the samples of a record: the exact linear motion, and the deviation from it that forces cause.

``compiled`` compiles these functions for a given number of coordinates.  The length of the tuple ``shape`` is H: the
compiler then knows the length of the loops over a state, which makes them several times faster, and unlike a closure the
compiled function can be cached.

A state is (scale q, 0, q', 0) with q and q' padded to H values each (an even number), so that both have the unit V.  E is the
exact propagator over half a substep h/2.  All matrices are transposed.

Shapes: N samples, M = (N - 1) substeps + 1 grid points, n coordinates (n <= H), D drives, T linear combinations of a state
(``taps``).  Units: seconds, volts.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from ...arrays import FloatArray, IntArray
from ...device.force_law import Laws, push

#: Options of functions that only compiled loops call; a wrapper for Python would be compiled in vain.
INSIDE: dict[str, Any] = {"forceinline": True, "no_cpython_wrapper": True}


@njit(**INSIDE)
def summed(
    size: int, transposed: FloatArray, offset: int, rows: int, x: FloatArray, row: int, out: FloatArray, to: int
) -> None:
    """out[to] = x[row, :rows] @ transposed[offset : offset + rows]; four sums at a time stay in registers.

    Rows are given by number: a view of a row would count references.
    """
    for i in range(0, size, 4):
        s0, s1, s2, s3 = 0.0, 0.0, 0.0, 0.0
        for j in range(rows):
            v = x[row, j]
            s0 += transposed[offset + j, i] * v
            s1 += transposed[offset + j, i + 1] * v
            s2 += transposed[offset + j, i + 2] * v
            s3 += transposed[offset + j, i + 3] * v
        out[to, i], out[to, i + 1], out[to, i + 2], out[to, i + 3] = s0, s1, s2, s3


@njit(**INSIDE)
def read_taps(size: int, taps: FloatArray, x: FloatArray, row: int, out: FloatArray, to: int) -> None:
    """out[to] = taps @ x[row]."""
    for tap in range(taps.shape[0]):
        total = 0.0
        for i in range(size):
            total += taps[tap, i] * x[row, i]
        out[to, tap] = total


def deviation_from_linear(
    shape: tuple[int, ...],
    more: tuple[int, ...],
    forces: IntArray,
    p: FloatArray,
    ends: IntArray,
    laws: Laws,
    half: FloatArray,
    held: FloatArray,
    ramp: FloatArray,
    beside: FloatArray,
    inverse: float,
    step_s: float,
    substeps: int,
    n: int,
    m: int,
    drive: FloatArray,
    sloped: bool,
    start: FloatArray,
    taps: FloatArray,
    linear: FloatArray,
    deviation: FloatArray,
) -> None:
    """Integrate d' = A d + (0, a(t, x_l + d, u)) along the linear motion x_l by Lawson-RK4; fill ``linear``, ``deviation``.

    Beside the n coordinates, m others that the linear motion does not move follow their own forces: they have their own
    propagator, because zeros would take most of a common one.

    Parameters
    ----------
    shape, more : tuples of H and of W zeros, m <= W.
    forces, p, ends, laws : of ``force_law.acting_forces``, and what force laws use.
    half, held, ramp : (2H, 2H), (D, 2H), (D, 2H) response over half a substep to a state, a drive and the slope of a drive.
    beside : E (2W, 2W) of the others.
    inverse, step_s, substeps : 1 / scale [s/rad], time between samples [s], substeps.
    n, m : numbers of coordinates that drives move and of the others, which follow them in the forces.
    drive, sloped : (N, D) [V]; whether the drive is linear between samples (first-order hold).
    start : (2H,) state at the first sample [V].
    taps : (T, 2H).
    linear : (M, T) taps of the linear motion, filled; (0, T) where it is not wanted.
    deviation : (M, T) taps of the deviation, filled.
    """
    half_size, wide = len(shape), len(more)
    size, double = 2 * half_size, 2 * wide
    drives = held.shape[0]
    h = step_s / substeps
    # A quotient that is a factor in a loop would become a division in it.
    sixth = h * (1.0 / 6.0)
    q, qd, out, u, slope = np.empty(n + m), np.empty(n + m), np.empty(n + m), np.empty(drives), np.empty(drives)
    # At the start, middle and end of a substep: linear motion, and the deviation without the forces since its start.
    motion, free = np.empty((3, size)), np.empty((3, size))
    # Forces k1 .. k4 at the stages; what k1 and k3 grow to in half a substep; state at a stage; response to the drive.
    k, grown, trial, driven = np.empty((4, half_size)), np.empty((2, size)), np.empty(size), np.empty(size)
    # The same of the others, which have no linear motion: ``free``, ``k`` and ``grown``.
    apart, pushed, own = np.zeros((3, double)), np.zeros((4, wide)), np.zeros((2, double))
    for i in range(half_size):
        for stage in range(4):
            k[stage, i] = 0.0
    for i in range(size):
        motion[0, i], free[0, i] = start[i], 0.0
    wants_linear = linear.shape[0] > 0
    read_taps(size, taps, free, 0, deviation, 0)
    if wants_linear:
        read_taps(size, taps, motion, 0, linear, 0)
    point = 0
    for sample in range(drive.shape[0] - 1):
        for d in range(drives):
            slope[d] = (drive[sample + 1, d] - drive[sample, d]) / step_s if sloped else 0.0
        for sub in range(substeps):
            local = sub * h
            t = laws.elapsed_s + sample * step_s + local
            for i in range(size):
                driven[i] = 0.0
            for d in range(drives):
                u[d] = drive[sample, d] + slope[d] * local
                for i in range(size):
                    driven[i] += held[d, i] * u[d] + ramp[d, i] * slope[d]
            for node in range(1, 3):
                summed(size, half, 0, size, motion, node - 1, motion, node)
                for i in range(size):
                    motion[node, i] += driven[i]
                for d in range(drives):
                    for i in range(size):
                        driven[i] += held[d, i] * slope[d] * (0.5 * h)
            if forces.size > 0:
                for stage in range(4):
                    node = (stage + 1) // 2
                    if stage == 1 or stage == 3:
                        summed(size, half, 0, size, free, node - 1, free, node)
                        summed(size, half, half_size, half_size, k, stage - 1, grown, node - 1)
                        for d in range(drives):
                            u[d] += slope[d] * 0.5 * h
                        for i in range(size):
                            trial[i] = motion[node, i] + free[node, i] + 0.5 * node * h * grown[node - 1, i]
                        if wide > 0:
                            summed(double, beside, 0, double, apart, node - 1, apart, node)
                            summed(double, beside, wide, wide, pushed, stage - 1, own, node - 1)
                            for i in range(m):
                                q[n + i] = (apart[node, i] + 0.5 * node * h * own[node - 1, i]) * inverse
                                qd[n + i] = apart[node, wide + i] + 0.5 * node * h * own[node - 1, wide + i]
                    else:
                        for i in range(size):
                            trial[i] = motion[node, i] + free[node, i]
                        if wide > 0:
                            for i in range(m):
                                q[n + i], qd[n + i] = apart[node, i] * inverse, apart[node, wide + i]
                    if stage == 2:
                        for i in range(n):
                            trial[half_size + i] += 0.5 * h * k[1, i]
                        if wide > 0:
                            for i in range(m):
                                qd[n + i] += 0.5 * h * pushed[1, i]
                    for i in range(n):
                        q[i], qd[i] = trial[i] * inverse, trial[half_size + i]
                    for i in range(n + m):
                        out[i] = 0.0
                    for f in range(forces.size):
                        push(forces[f], t + 0.5 * node * h, q, qd, u, p, ends[f], ends[f + 1], laws, out)
                    for i in range(n):
                        k[stage, i] = out[i]
                    if wide > 0:
                        for i in range(m):
                            pushed[stage, i] = out[n + i]
                # d <- E^2 d + h/6 (E (E k1 + 2 (k2 + k3)) + k4),  E the exponential of half a substep
                for i in range(n):
                    grown[0, half_size + i] += 2.0 * (k[1, i] + k[2, i])
                summed(size, half, 0, size, grown, 0, grown, 1)
                for i in range(size):
                    free[0, i] = free[2, i] + sixth * grown[1, i]
                for i in range(n):
                    free[0, half_size + i] += sixth * k[3, i]
                if wide > 0:
                    for i in range(m):
                        own[0, wide + i] += 2.0 * (pushed[1, i] + pushed[2, i])
                    summed(double, beside, 0, double, own, 0, own, 1)
                    for i in range(double):
                        apart[0, i] = apart[2, i] + sixth * own[1, i]
                    for i in range(m):
                        apart[0, wide + i] += sixth * pushed[3, i]
            for i in range(size):
                motion[0, i] = motion[2, i]
            point += 1
            read_taps(size, taps, free, 0, deviation, point)
            if wants_linear:
                read_taps(size, taps, motion, 0, linear, point)


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
    driven, slope = np.empty(size), np.empty(drives)
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
            summed(size, half, 0, size, out, row, out, row + 1)
            row += 1
            for i in range(size):
                out[row, i] += driven[i]
