"""The read-out filter applied to pick-off volts on the integrator's grid.

    y = static r + 2 Re sum_j R_j x_j,   x_j' = q_j x_j + r

r is taken as the polynomial through the m + 1 grid points of each sample interval; for that polynomial the result is exact.

Shapes: N samples, m substeps, M = (N - 1) m + 1 grid points, J poles (one of each conjugate pair), S senses.
Units: poles and residues in rad/s, time in seconds, signals in volts.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit, types

from ...arrays import ComplexArray, FloatArray, real_parts
from ...threads import once
from .compiled import OPTIONS

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(48)


def _weights(poles: ComplexArray, nodes: FloatArray, until: float) -> ComplexArray:
    """int_0^until exp(q (until - s)) L_i(s) ds, (J, nodes) [s], with the Lagrange polynomials L_i on ``nodes`` [s]."""
    size = nodes.size
    # Monomial coefficients of L_i in s / span.
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


# As in ``kernels``, the length of a tuple (``lanes``) is a constant to the compiler.
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
    """Add the poles' response to r (M, S) to ``out`` (N, S); if ``late``, a time after each sample.

    z and w advance a state by one sample interval, z_out and w_out by the time after each sample at which it is read.
    The length of ``lanes`` is J.  Arrays hold real parts, then imaginary parts: z (2, J), w (2, m + 1, J), residues
    (2, S, S, J).
    """
    samples, senses = out.shape
    x = np.zeros((senses, 2, len(lanes)))
    read = np.zeros((2, len(lanes)))
    # Without crosstalk a channel is read from its own states only, half of the sums.
    mixed = np.zeros((senses, senses), np.bool_)
    for a in range(senses):
        for b in range(senses):
            for j in range(len(lanes)):
                mixed[a, b] |= residues[0, a, b, j] != 0.0 or residues[1, a, b, j] != 0.0
    for sample in range(samples):
        first = sample * substeps
        last = sample + 1 == samples
        for b in range(senses):
            for j in range(len(lanes)):
                read[0, j], read[1, j] = x[b, 0, j], x[b, 1, j]
            if late:
                for j in range(len(lanes)):
                    re, im = x[b, 0, j], x[b, 1, j]
                    read[0, j], read[1, j] = z_out[0, j] * re - z_out[1, j] * im, z_out[0, j] * im + z_out[1, j] * re
                for i in range(0 if last else substeps + 1):
                    for j in range(len(lanes)):
                        read[0, j] += w_out[0, i, j] * r[first + i, b]
                        read[1, j] += w_out[1, i, j] * r[first + i, b]
            for a in range(senses):
                if not mixed[a, b]:
                    continue
                total = 0.0
                for j in range(len(lanes)):
                    total += residues[0, a, b, j] * read[0, j] - residues[1, a, b, j] * read[1, j]
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
def compiled_filter(lanes: int) -> Any:
    """``_filter`` compiled for that many poles."""
    two, three, four = (types.Array(types.float64, k, "C") for k in (2, 3, 4))
    shape = types.UniTuple(types.int64, lanes)
    signature = types.void(shape, types.int64, two, three, two, three, types.boolean, four, two, two)
    return njit(signature, **OPTIONS)(_filter)


def filtered(
    poles: ComplexArray,
    residues: ComplexArray,
    static: FloatArray,
    r: FloatArray,
    step_s: float,
    late_s: float,
    substeps: int,
) -> FloatArray:
    """The read-out's response (N, S) [V] to pick-off volts r, read ``late_s`` after each sample.

    Parameters
    ----------
    poles, residues : of the read-out, (J,) and (J, S, S) [rad/s]: one of each conjugate pair, real poles with half their
        residue.
    static : (S, S) gain that no pole filters.
    r : (M, S) pick-off volts on the integrator's grid.
    step_s : time between samples [s].
    late_s : in [0, step_s) [s]; the last sample is read as if r ended there.
    substeps : m.
    """
    samples = (r.shape[0] - 1) // substeps + 1
    nodes = np.arange(substeps + 1, dtype=np.float64) * (step_s / substeps)
    interpolate: FloatArray = np.zeros(substeps + 1)
    interpolate[0] = 1.0
    if late_s > 0.0:
        fit: FloatArray = np.linalg.inv(np.vander(nodes / step_s, increasing=True)).astype(np.float64)
        interpolate[:] = (late_s / step_s) ** np.arange(substeps + 1) @ fit
    out = np.zeros((samples, r.shape[1]))
    windows = np.lib.stride_tricks.sliding_window_view(r, substeps + 1, axis=0)[::substeps]
    if np.any(static):
        out[:-1] = (windows @ interpolate) @ static.T
        out[-1] = r[-1] @ static.T
    if poles.size:
        late = late_s > 0.0
        lanes = 1 << (poles.size - 1).bit_length()
        padded = np.concatenate([poles, np.zeros(lanes - poles.size)])
        no_weights = np.zeros((lanes - poles.size, nodes.size))

        def weights(until: float) -> FloatArray:
            own = np.concatenate([_weights(poles, nodes, until), no_weights])
            return np.ascontiguousarray(np.swapaxes(real_parts(own), 1, 2))

        padded_residues = np.zeros((lanes, *residues.shape[1:]), dtype=np.complex128)
        padded_residues[: poles.size] = residues
        compiled_filter(lanes)(
            (0,) * lanes,
            substeps,
            real_parts(np.exp(padded * step_s)),
            weights(step_s),
            real_parts(np.exp(padded * late_s)),
            weights(late_s) if late else np.zeros((2, nodes.size, lanes)),
            late,
            np.ascontiguousarray(np.moveaxis(real_parts(padded_residues), 1, 3)),
            np.ascontiguousarray(r),
            out,
        )
    return out
