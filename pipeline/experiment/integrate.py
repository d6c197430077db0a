"""Motion under forces that are not linear or not constant in time, on a grid finer than the samples.

    q'' + (C + G) q' + K q = F u(t) + a(t, q, q', u)

The linear trajectory x_l under the held drive is exact (matrix exponential); what is integrated is the deviation d from it,

    d' = A d + (0, a(t, x_l + d, u))

by Lawson-RK4 with the exact exponential of A, ``SUBSTEPS`` steps a sample: no cancellation, and the kinks of the held drive
stay in the exact part.  Its remainder in volts, r = (V, D) d + (sense laws), is smooth between samples, so the read-out's poles
see it exactly as the polynomial through the ``SUBSTEPS`` + 1 values of each sample interval.

Shapes: N samples, M = (N - 1) SUBSTEPS + 1 grid points, n coordinates, D drives, S senses.  State (2n,): (q, q').
"""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
from numba import njit, types
from scipy.linalg import expm

from ..arrays import ComplexArray, FloatArray
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
def _accelerate(forces: Any, count: int, p: Any, laws: Laws, t: float, scale: float, y: FloatArray, d: FloatArray, u: FloatArray, q: FloatArray, qd: FloatArray, out: FloatArray) -> None:  # fmt: skip
    """a(t, x_l + d, u) into ``out`` (n,); y and d hold (scale q, q')."""
    n = q.size
    for i in range(n):
        q[i] = (y[i] + d[i]) / scale
        qd[i] = y[n + i] + d[n + i]
        out[i] = 0.0
    for k in range(count):
        forces[k](t, q, qd, u, p[k], laws, out)


_KERNEL = types.void(
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
    _MATRIX,
    types.boolean,
    _VECTOR,
    _MATRIX,
    _MATRIX,
)


def _march(
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
    drive: FloatArray,
    sloped: bool,
    start: FloatArray,
    linear: FloatArray,
    deviation: FloatArray,
) -> None:
    """March both over the grid; ``half``, ``held`` (2n, D) and ``ramp`` propagate by half a substep, states are (scale q, q')."""
    size, drives = held.shape
    n = size // 2
    samples = drive.shape[0]
    h = step_s / substeps
    q, qd, u, slope = np.empty(n), np.empty(n), np.empty(drives), np.zeros(drives)
    k1, k2, k3, k4 = np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    y, middle, after = start.copy(), np.empty(size), np.empty(size)
    d, e1, e2, w, trial = np.zeros(size), np.empty(size), np.empty(size), np.empty(size), np.empty(size)
    linear[0], deviation[0] = y, d
    for sample in range(samples - 1):
        for k in range(drives):
            slope[k] = (drive[sample + 1, k] - drive[sample, k]) / step_s if sloped else 0.0
        for sub in range(substeps):
            local = sub * h
            t = sample * step_s + local
            for i in range(size):
                total = 0.0
                for j in range(size):
                    total += half[i, j] * y[j]
                for k in range(drives):
                    total += held[i, k] * (drive[sample, k] + slope[k] * local) + ramp[i, k] * slope[k]
                middle[i] = total
            for i in range(size):
                total = 0.0
                for j in range(size):
                    total += half[i, j] * middle[j]
                for k in range(drives):
                    total += held[i, k] * (drive[sample, k] + slope[k] * (local + 0.5 * h)) + ramp[i, k] * slope[k]
                after[i] = total
            if count > 0:
                for k in range(drives):
                    u[k] = drive[sample, k] + slope[k] * local
                _accelerate(forces, count, p, laws, t, scale, y, d, u, q, qd, k1)
                for i in range(size):
                    moved, kicked = 0.0, 0.0
                    for j in range(size):
                        moved += half[i, j] * d[j]
                    for j in range(n):
                        kicked += half[i, n + j] * k1[j]
                    e1[i], w[i] = moved, kicked
                    trial[i] = moved + 0.5 * h * kicked
                for k in range(drives):
                    u[k] += slope[k] * 0.5 * h
                _accelerate(forces, count, p, laws, t + 0.5 * h, scale, middle, trial, u, q, qd, k2)
                for i in range(n):
                    trial[i] = e1[i]
                    trial[n + i] = e1[n + i] + 0.5 * h * k2[i]
                _accelerate(forces, count, p, laws, t + 0.5 * h, scale, middle, trial, u, q, qd, k3)
                for i in range(size):
                    moved, kicked = 0.0, 0.0
                    for j in range(size):
                        moved += half[i, j] * e1[j]
                    for j in range(n):
                        kicked += half[i, n + j] * k3[j]
                    e2[i] = moved
                    trial[i] = moved + h * kicked
                for k in range(drives):
                    u[k] += slope[k] * 0.5 * h
                _accelerate(forces, count, p, laws, t + h, scale, after, trial, u, q, qd, k4)
                for i in range(size):
                    kicked = 0.0
                    for j in range(size):
                        kicked += half[i, j] * w[j]
                    for j in range(n):
                        kicked += 2.0 * half[i, n + j] * (k2[j] + k3[j])
                    d[i] = e2[i] + h / 6.0 * kicked
                for i in range(n):
                    d[n + i] += h / 6.0 * k4[i]
            for i in range(size):
                y[i] = after[i]
            point = sample * substeps + sub + 1
            linear[point], deviation[point] = y, d


with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    _march_compiled = njit(_KERNEL, cache=True, error_model="numpy")(_march)


def trajectory(
    mechanics: Mechanics,
    forces: list[tuple[Any, FloatArray]],
    laws: Laws,
    drive: FloatArray,
    step_s: float,
    hold: Hold,
    start: FloatArray | None,
    substeps: int = SUBSTEPS,
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
    points = (drive.shape[0] - 1) * substeps + 1
    linear, deviation = np.empty((points, 2 * n)), np.empty((points, 2 * n))
    laws_ready = [compiled_force(force) for force, _ in forces]
    padding = MOST_FORCES - len(forces)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        _march_compiled(
            tuple(laws_ready + [compiled_force(_no_force)] * padding),
            len(forces),
            tuple([np.ascontiguousarray(p, dtype=np.float64) for _, p in forces] + [np.zeros(1)] * padding),
            laws,
            np.ascontiguousarray(moved[: 2 * n, : 2 * n]),
            np.ascontiguousarray(moved[: 2 * n, 2 * n : 2 * n + drives]),
            np.ascontiguousarray(moved[: 2 * n, 2 * n + drives :]),
            scale,
            step_s,
            substeps,
            np.ascontiguousarray(drive),
            hold != "zoh",
            np.zeros(2 * n) if start is None else np.ascontiguousarray(start * unit),
            linear,
            deviation,
        )
    if not np.isfinite(deviation[-1]).all():
        raise ConfigError("the motion diverges", next_step="check size and sign of the nonlinear effects")
    return linear / unit, deviation / unit


def _weights(poles: ComplexArray, nodes: FloatArray, until: float) -> ComplexArray:
    """int_0^until exp(q (until - s)) L_i(s) ds, (J, nodes): L_i the Lagrange polynomials on ``nodes`` [s]."""
    size = nodes.size
    # Monomial coefficients of L_i in s/T.
    span = nodes[-1]
    basis = np.linalg.inv(np.vander(nodes / span, increasing=True))
    out = np.empty((poles.size, size), dtype=np.complex128)
    s, w = np.polynomial.legendre.leggauss(48)
    s, w = 0.5 * until * (s + 1.0), 0.5 * until * w
    for j, q in enumerate(poles):
        if abs(q) * until < 40.0:
            moments = np.array([np.sum(w * np.exp(q * (until - s)) * (s / span) ** k) for k in range(size)])
        else:
            moments = np.empty(size, dtype=np.complex128)
            moments[0] = np.expm1(q * until) / q
            for k in range(1, size):
                moments[k] = (k * moments[k - 1] / span - (until / span) ** k) / q
        out[j] = moments @ basis
    return out


@njit(cache=True)
def _filter(z: ComplexArray, w: ComplexArray, z_out: ComplexArray, w_out: ComplexArray, residues: ComplexArray, r: FloatArray, out: FloatArray) -> None:  # fmt: skip
    """Poles z (J,) with weights w (J, m + 1) over remainders r (M, S) -> out (N, S), read off after z_out, w_out."""
    poles, width = w.shape
    samples, senses = out.shape
    x = np.zeros((poles, senses), dtype=np.complex128)
    for sample in range(samples):
        first = sample * (width - 1)
        last = sample + 1 == samples
        for j in range(poles):
            for b in range(senses):
                seen = z_out[j] * x[j, b]
                if not last:
                    for i in range(width):
                        seen += w_out[j, i] * r[first + i, b]
                for a in range(senses):
                    g = residues[j, a, b]
                    out[sample, a] += 2.0 * (g.real * seen.real - g.imag * seen.imag)
                if not last:
                    total = z[j] * x[j, b]
                    for i in range(width):
                        total += w[j, i] * r[first + i, b]
                    x[j, b] = total


def filtered(
    poles: ComplexArray,
    residues: ComplexArray,
    static: FloatArray,
    remainder: FloatArray,
    step_s: float,
    late_s: float = 0.0,
    substeps: int = SUBSTEPS,
) -> FloatArray:
    """A remainder (M, S) behind the read-out, at ``late_s`` after each sample, (N, S).

    Parameters
    ----------
    poles, residues : of the read-out, (J,) and (J, S, S): one of each conjugate pair, real ones with half their residue.
    static : (S, S).
    remainder : volts on the fine grid.
    step_s : time between samples [s].
    late_s : in [0, step_s); the last sample is read as if the remainder ended there.
    """
    samples = (remainder.shape[0] - 1) // substeps + 1
    nodes = np.arange(substeps + 1) * (step_s / substeps)
    interpolate = np.zeros(substeps + 1)
    interpolate[0] = 1.0
    if late_s > 0.0:
        fit = np.linalg.inv(np.vander(nodes / step_s, increasing=True))
        interpolate = (late_s / step_s) ** np.arange(substeps + 1) @ fit
    out = np.zeros((samples, remainder.shape[1]))
    windows = np.lib.stride_tricks.sliding_window_view(remainder, substeps + 1, axis=0)[::substeps]
    if np.any(static):
        out[:-1] = (windows @ interpolate) @ static.T
        out[-1] = remainder[-1] @ static.T
    if poles.size:
        _filter(
            np.exp(poles * step_s),
            _weights(poles, nodes, step_s),
            np.exp(poles * late_s),
            _weights(poles, nodes, late_s) if late_s > 0.0 else np.zeros((poles.size, nodes.size), dtype=np.complex128),
            np.ascontiguousarray(residues, dtype=np.complex128),
            np.ascontiguousarray(remainder),
            out,
        )
    return out
