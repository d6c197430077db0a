"""Compiled loops over a record: the exact linear motion, and what forces add to it.

A state is (scale q, 0, q', 0), padded to 2H; ``E`` is the exact propagator over half a substep h/2, matrices are
transposed.

Shapes: N samples, M = (N - 1) substeps + 1 grid points, n coordinates of at most H, D drives, T taps read off a state.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit, types

from ...arrays import FloatArray
from ...device.effect import FORCE_TYPE, LAWS_TYPE, Laws
from ...threads import once

MOST_FORCES = 8

_VECTOR = types.Array(types.float64, 1, "C")
_MATRIX = types.Array(types.float64, 2, "C")


@njit(inline="always")
def _summed(size: int, transposed: FloatArray, offset: int, rows: int, x: FloatArray, out: FloatArray) -> None:
    """out = x[:rows] @ transposed[offset : offset + rows], two sums at a time: they stay in registers."""
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
def _kicked(shape: tuple[int, ...], transposed: FloatArray, a: FloatArray, out: FloatArray) -> None:
    _summed(2 * len(shape), transposed, len(shape), len(shape), a, out)


@njit(inline="always")
def _dot(shape: tuple[int, ...], taps: FloatArray, tap: int, x: FloatArray) -> float:
    total = 0.0
    for i in range(2 * len(shape)):
        total += taps[tap, i] * x[i]
    return total


# A tuple's length is a constant to the compiler: loops of constant length run several times faster, and unlike a closure
# the kernel is found again in the cache.
def _march(
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
    """Integrate the deviation; the length of ``shape`` is the most coordinates H, known when this is compiled.

    forces, how many, their parameters and laws; ``half``, ``held``, ``ramp`` (transposed: (2H, 2H), (D, 2H), (D, 2H))
    propagate a state (scale q, 0, q', 0) by half a substep; scale; time between samples; substeps; coordinates n; drive
    (N, D); whether it is sloped between samples; start; what is read off a state (T, 2H); then linear (M, T), or (0, T)
    where it is not wanted, and deviation (M, T).
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
    middle, after, d, push = np.empty(size), np.empty(size), np.zeros(size), np.empty(size)
    for i in range(size):
        y[i] = start[i]
    whole = linear.shape[0] > 0
    for tap in range(taps.shape[0]):
        deviation[0, tap] = 0.0
        if whole:
            linear[0, tap] = _dot(shape, taps, tap, y)
    for sample in range(samples - 1):
        for k in range(drives):
            slope[k] = (drive[sample + 1, k] - drive[sample, k]) / step_s if sloped else 0.0
        for sub in range(substeps):
            local = sub * h
            t = sample * step_s + local
            for i in range(size):
                push[i] = 0.0
            for k in range(drives):
                u[k] = drive[sample, k] + slope[k] * local
                for i in range(size):
                    push[i] += held[k, i] * u[k] + ramp[k, i] * slope[k]
            _propagate(shape, half, y, middle)
            for i in range(size):
                middle[i] += push[i]
            _propagate(shape, half, middle, after)
            for k in range(drives):
                for i in range(size):
                    push[i] += held[k, i] * slope[k] * (0.5 * h)
            for i in range(size):
                after[i] += push[i]
            if count > 0:
                for i in range(n):
                    q[i], qd[i], out[i] = (y[i] + d[i]) * inverse, y[half_size + i] + d[half_size + i], 0.0
                for k in range(count):
                    forces[k](t, q, qd, u, p[k], laws, out)
                for i in range(n):
                    k1[i] = out[i]
                _propagate(shape, half, d, e1)
                _kicked(shape, half, k1, w)
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
                _kicked(shape, half, k3, trial)
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
                if whole:
                    linear[point, tap] = _dot(shape, taps, tap, y)


def _states(
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
    """The linear motion at half substeps (2M - 1, 2H); arguments as in ``_march``."""
    size = 2 * len(shape)
    drives = held.shape[0]
    half_s = 0.5 * step_s / substeps
    push, slope = np.empty(size), np.zeros(drives)
    for i in range(size):
        out[0, i] = start[i]
    row = 0
    for sample in range(drive.shape[0] - 1):
        for k in range(drives):
            slope[k] = (drive[sample + 1, k] - drive[sample, k]) / step_s if sloped else 0.0
        for part in range(2 * substeps):
            for i in range(size):
                push[i] = 0.0
            for k in range(drives):
                u = drive[sample, k] + slope[k] * (part * half_s)
                for i in range(size):
                    push[i] += held[k, i] * u + ramp[k, i] * slope[k]
            _propagate(shape, half, out[row], out[row + 1])
            row += 1
            for i in range(size):
                out[row, i] += push[i]


def _along(
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
    """What weak forces along known ``states`` (2M - 1, 2H) move, to first order in them; else as in ``_march``.

    d <- E^2 d + h/6 (E^2 k1 + 4 E k2 + k3),  ``whole`` is E^2, k the forces at both ends and in the middle.
    """
    half_size = len(shape)
    size = 2 * half_size
    drives = drive.shape[1]
    h = step_s / substeps
    inverse = 1.0 / scale
    q, qd, out, u, slope = np.empty(n), np.empty(n), np.empty(n), np.empty(drives), np.zeros(drives)
    kick, d, before, trial = np.zeros(half_size), np.zeros(size), np.empty(size), np.empty(size)
    for tap in range(taps.shape[0]):
        deviation[0, tap] = 0.0
    for sample in range(drive.shape[0] - 1):
        for k in range(drives):
            slope[k] = (drive[sample + 1, k] - drive[sample, k]) / step_s if sloped else 0.0
        for sub in range(substeps):
            point = sample * substeps + sub
            t = sample * step_s + sub * h
            for node in range(3):
                # What the last substep ended with serves, but for a held drive that has jumped.
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
                        kick[i] = h / 1.5 * out[i]
                    _kicked(shape, half, kick, trial)
                    for i in range(size):
                        d[i] += trial[i]
                else:
                    for i in range(n):
                        d[half_size + i] += h / 6.0 * out[i]
            for tap in range(taps.shape[0]):
                deviation[point + 1, tap] = _dot(shape, taps, tap, d)


#: How loops over samples are compiled.
OPTIONS: dict[str, Any] = {
    "cache": True,
    "nogil": True,
    "error_model": "numpy",
    "fastmath": {"contract", "reassoc", "nsz"},
}
_FORCES = (types.UniTuple(FORCE_TYPE, MOST_FORCES), types.int64, types.UniTuple(_VECTOR, MOST_FORCES), LAWS_TYPE)
_CLOCK = (types.float64, types.int64)
_DRIVE = (_MATRIX, types.boolean)


@once
def march_of(half_size: int) -> Any:
    """``_march`` compiled for at most ``half_size`` coordinates."""
    shape = types.UniTuple(types.int64, half_size)
    matrices = (_MATRIX, _MATRIX, _MATRIX, types.float64)
    reads = (_VECTOR, _MATRIX, _MATRIX, _MATRIX)
    signature = types.void(shape, *_FORCES, *matrices, *_CLOCK, types.int64, *_DRIVE, *reads)
    return njit(signature, **OPTIONS)(_march)


@once
def states_of(half_size: int) -> Any:
    """``_states`` compiled for at most ``half_size`` coordinates."""
    shape = types.UniTuple(types.int64, half_size)
    return njit(types.void(shape, _MATRIX, _MATRIX, _MATRIX, *_CLOCK, *_DRIVE, _VECTOR, _MATRIX), **OPTIONS)(_states)


@once
def along_of(half_size: int) -> Any:
    """``_along`` compiled for at most ``half_size`` coordinates."""
    shape = types.UniTuple(types.int64, half_size)
    matrices = (_MATRIX, _MATRIX, types.float64)
    reads = (_MATRIX, _MATRIX, _MATRIX)
    return njit(types.void(shape, *_FORCES, *matrices, *_CLOCK, types.int64, *_DRIVE, *reads), **OPTIONS)(_along)
