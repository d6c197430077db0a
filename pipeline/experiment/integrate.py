"""Motion under forces that are not linear or not constant in time, on a grid finer than the samples.

    q'' + (C + G) q' + K q = F u(t) + a(t, q, q', u)

The linear trajectory x_l under the held drive is exact (matrix exponential); what is integrated is the deviation d from it,

    d' = A d + (0, a(t, x_l + d, u))

by Lawson-RK4 with the exact exponential of A, ``SUBSTEPS`` steps a sample: no cancellation, and the kinks of the held
drive stay in the exact part.  Its remainder in volts, r = (V, D) d + (sense laws), is smooth between samples: the read-out
(``readout_filter``) sees it as the polynomial through the ``SUBSTEPS`` + 1 values of each sample interval.

Shapes: N samples, M = (N - 1) SUBSTEPS + 1 grid points, n coordinates, D drives, S senses.  State (2n,): (q, q').
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit, types
from scipy.linalg import expm

from ..arrays import FloatArray
from ..device.effect import FORCE_TYPE, LAWS_TYPE, Laws, compiled_force
from ..device.mechanics import Mechanics, state_matrix
from ..errors import ConfigError
from .instrument import Hold

SUBSTEPS = 4
MOST_FORCES = 8

_VECTOR = types.Array(types.float64, 1, "C")
_MATRIX = types.Array(types.float64, 2, "C")


def _no_force(
    t: float, q: FloatArray, qd: FloatArray, u: FloatArray, p: FloatArray, laws: Laws, out: FloatArray
) -> None:
    return


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


_KERNEL = (
    types.UniTuple(FORCE_TYPE, MOST_FORCES),
    types.int64,
    types.UniTuple(_VECTOR, MOST_FORCES),
    LAWS_TYPE,
    _MATRIX,
    _MATRIX,
    _MATRIX,
    types.float64,
    types.float64,
    types.int64,
    types.int64,
    _MATRIX,
    types.boolean,
    _VECTOR,
    _MATRIX,
    _MATRIX,
    _MATRIX,
)


@lru_cache(maxsize=8)
def _march_of(half_size: int) -> Any:
    """The compiled kernel for at most ``half_size`` coordinates."""
    signature = types.void(types.UniTuple(types.int64, half_size), *_KERNEL)
    return njit(signature, cache=True, nogil=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz"})(_march)


def trajectory(
    mechanics: Mechanics,
    forces: list[tuple[Any, FloatArray]],
    laws: Laws,
    drive: FloatArray,
    step_s: float,
    hold: Hold,
    start: FloatArray | None,
    substeps: int = SUBSTEPS,
    reads: FloatArray | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Linear trajectory and deviation from it, both (M, 2n), under ``drive`` (N, D).

    Parameters
    ----------
    mechanics : a batch of one.
    forces : force laws (as the effect has them) and their parameters (k,).
    laws : what force laws may use.
    drive : volts that make force.
    step_s : time between samples [s].
    hold : "zoh" or "foh".
    start : state (2n,) at the first sample; ``None`` is rest.
    reads : (S, 2n), where only what it reads off the deviation is wanted: then (0, S) and (M, S).

    Raises
    ------
    ConfigError : more than ``MOST_FORCES`` forces, or a motion that diverges.
    """
    if len(forces) > MOST_FORCES:
        raise ConfigError("too many forces at once", value=len(forces), allowed=f"at most {MOST_FORCES}")
    a = state_matrix(mechanics)[0]
    n, drives = mechanics.drive.shape[1:]
    # In (omega q, q') the exponential is of a matrix of even size: no digits are lost.
    scale = float(np.sqrt(np.mean(np.diagonal(mechanics.stiffness[0]))))
    unit = np.concatenate([np.full(n, scale), np.ones(n)])
    grown = np.zeros((2 * n + 2 * drives, 2 * n + 2 * drives))
    grown[: 2 * n, : 2 * n] = a * unit[:, None] / unit
    grown[n : 2 * n, 2 * n : 2 * n + drives] = mechanics.drive[0]
    grown[2 * n : 2 * n + drives, 2 * n + drives :] = np.eye(drives)
    moved = expm(grown * (0.5 * step_s / substeps))
    half_size = n if n <= 4 else 1 << (n - 1).bit_length()
    place = np.concatenate([np.arange(n), half_size + np.arange(n)])

    def placed(matrix: FloatArray) -> FloatArray:
        """Rows of a transposed propagator (r, 2n) at their places in (r, 2H)."""
        out = np.zeros((matrix.shape[0], 2 * half_size))
        out[:, place] = matrix
        return out

    half = np.zeros((2 * half_size, 2 * half_size))
    half[place] = placed(moved[: 2 * n, : 2 * n].T)
    points = (drive.shape[0] - 1) * substeps + 1
    wanted = np.eye(2 * n) if reads is None else reads
    taps = placed(wanted / unit)
    linear = np.empty((points if reads is None else 0, taps.shape[0]))
    deviation = np.empty((points, taps.shape[0]))
    padding = MOST_FORCES - len(forces)
    _march_of(half_size)(
        (0,) * half_size,
        tuple([compiled_force(force) for force, _ in forces] + [compiled_force(_no_force)] * padding),
        len(forces),
        tuple([np.ascontiguousarray(p, dtype=np.float64) for _, p in forces] + [np.zeros(1)] * padding),
        laws,
        half,
        placed(moved[: 2 * n, 2 * n : 2 * n + drives].T),
        placed(moved[: 2 * n, 2 * n + drives :].T),
        scale,
        step_s,
        substeps,
        n,
        np.ascontiguousarray(drive),
        hold != "zoh",
        placed((np.zeros(2 * n) if start is None else start * unit)[None])[0],
        taps,
        linear,
        deviation,
    )
    if not np.isfinite(deviation[-1]).all():
        raise ConfigError("the motion diverges", next_step="check size and sign of the nonlinear effects")
    return linear, deviation
