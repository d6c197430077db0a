"""A remainder on the integrator's grid behind the poles of the read-out, exact for the polynomial through each interval.

Shapes: N samples, m substeps, M = (N - 1) m + 1 grid points, J poles (one of each conjugate pair), S senses.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit, types

from ...arrays import ComplexArray, FloatArray, real_parts
from ...threads import once
from .kernels import OPTIONS

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(48)


def _weights(poles: ComplexArray, nodes: FloatArray, until: float) -> ComplexArray:
    """int_0^until exp(q (until - s)) L_i(s) ds, (J, nodes): L_i the Lagrange polynomials on ``nodes`` [s]."""
    size = nodes.size
    # Monomial coefficients of L_i in s/T.
    span = nodes[-1]
    basis = np.linalg.inv(np.vander(nodes / span, increasing=True))
    out = np.empty((poles.size, size), dtype=np.complex128)
    s, w = 0.5 * until * (_NODES + 1.0), 0.5 * until * _WEIGHTS
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


# As in ``kernels``, a tuple's length is a constant to the compiler.
def _filter(
    lanes: tuple[int, ...],
    substeps: int,
    z: FloatArray,
    w: FloatArray,
    z_out: FloatArray,
    w_out: FloatArray,
    late: bool,
    residues: FloatArray,
    r: FloatArray,
    out: FloatArray,
) -> None:
    """Remainders r (M, S) behind poles -> out (N, S), read off after z_out, w_out if late.

    J is the length of ``lanes``.  Real parts come before imaginary ones: z (2, J), w (2, m + 1, J), residues (2, S, S,
    J).
    """
    samples, senses = out.shape
    x = np.zeros((senses, 2, len(lanes)))
    seen = np.zeros((2, len(lanes)))
    for sample in range(samples):
        first = sample * substeps
        last = sample + 1 == samples
        for b in range(senses):
            for j in range(len(lanes)):
                seen[0, j], seen[1, j] = x[b, 0, j], x[b, 1, j]
            if late:
                for j in range(len(lanes)):
                    re, im = x[b, 0, j], x[b, 1, j]
                    seen[0, j], seen[1, j] = z_out[0, j] * re - z_out[1, j] * im, z_out[0, j] * im + z_out[1, j] * re
                for i in range(0 if last else substeps + 1):
                    for j in range(len(lanes)):
                        seen[0, j] += w_out[0, i, j] * r[first + i, b]
                        seen[1, j] += w_out[1, i, j] * r[first + i, b]
            for a in range(senses):
                total = 0.0
                for j in range(len(lanes)):
                    total += residues[0, a, b, j] * seen[0, j] - residues[1, a, b, j] * seen[1, j]
                out[sample, a] += 2.0 * total
            if not last:
                for j in range(len(lanes)):
                    re, im = x[b, 0, j], x[b, 1, j]
                    x[b, 0, j], x[b, 1, j] = z[0, j] * re - z[1, j] * im, z[0, j] * im + z[1, j] * re
                for i in range(substeps + 1):
                    for j in range(len(lanes)):
                        x[b, 0, j] += w[0, i, j] * r[first + i, b]
                        x[b, 1, j] += w[1, i, j] * r[first + i, b]


@once
def _filter_of(lanes: int) -> Any:
    """``_filter`` compiled for that many poles."""
    two, three, four = (types.Array(types.float64, k, "C") for k in (2, 3, 4))
    shape = types.UniTuple(types.int64, lanes)
    signature = types.void(shape, types.int64, two, three, two, three, types.boolean, four, two, two)
    return njit(signature, **OPTIONS)(_filter)


def filtered(
    poles: ComplexArray,
    residues: ComplexArray,
    static: FloatArray,
    remainder: FloatArray,
    step_s: float,
    late_s: float,
    substeps: int,
) -> FloatArray:
    """A remainder (M, S) behind the read-out, at ``late_s`` after each sample, (N, S).

    Parameters
    ----------
    poles, residues : of the read-out, (J,) and (J, S, S): one of each conjugate pair, real ones with half their
        residue.
    static : (S, S).
    remainder : volts on the fine grid.
    step_s : time between samples [s].
    late_s : in [0, step_s); the last sample is read as if the remainder ended there.
    """
    samples = (remainder.shape[0] - 1) // substeps + 1
    nodes = np.arange(substeps + 1, dtype=np.float64) * (step_s / substeps)
    interpolate: FloatArray = np.zeros(substeps + 1)
    interpolate[0] = 1.0
    if late_s > 0.0:
        fit: FloatArray = np.linalg.inv(np.vander(nodes / step_s, increasing=True)).astype(np.float64)
        interpolate[:] = (late_s / step_s) ** np.arange(substeps + 1) @ fit
    out = np.zeros((samples, remainder.shape[1]))
    windows = np.lib.stride_tricks.sliding_window_view(remainder, substeps + 1, axis=0)[::substeps]
    if np.any(static):
        out[:-1] = (windows @ interpolate) @ static.T
        out[-1] = remainder[-1] @ static.T
    if poles.size:
        late = late_s > 0.0
        lanes = 1 << (poles.size - 1).bit_length()
        padded = np.concatenate([poles, np.zeros(lanes - poles.size)])
        weighed = np.zeros((lanes - poles.size, nodes.size))

        def weights(until: float) -> FloatArray:
            own = np.concatenate([_weights(poles, nodes, until), weighed])
            return np.ascontiguousarray(np.swapaxes(real_parts(own), 1, 2))

        seen = np.zeros((lanes, *residues.shape[1:]), dtype=np.complex128)
        seen[: poles.size] = residues
        _filter_of(lanes)(
            (0,) * lanes,
            substeps,
            real_parts(np.exp(padded * step_s)),
            weights(step_s),
            real_parts(np.exp(padded * late_s)),
            weights(late_s) if late else np.zeros((2, nodes.size, lanes)),
            late,
            np.ascontiguousarray(np.moveaxis(real_parts(seen), 1, 3)),
            np.ascontiguousarray(remainder),
            out,
        )
    return out
