"""A remainder on the integrator's grid behind the poles of the read-out, exact for the polynomial through each interval.

Shapes: N samples, m substeps, M = (N - 1) m + 1 grid points, J poles (one of each conjugate pair), S senses.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from ..arrays import ComplexArray, FloatArray, real_parts

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


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz"})
def _filter(
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

    Real parts come before imaginary ones: z (2, J), w (2, J, m + 1), residues (2, J, S, S).
    """
    _, poles, width = w.shape
    samples, senses = out.shape
    x = np.zeros((2, poles, senses))
    for sample in range(samples):
        first = sample * (width - 1)
        last = sample + 1 == samples
        for j in range(poles):
            for b in range(senses):
                re, im = x[0, j, b], x[1, j, b]
                seen_re, seen_im = re, im
                if late:
                    seen_re, seen_im = z_out[0, j] * re - z_out[1, j] * im, z_out[0, j] * im + z_out[1, j] * re
                    if not last:
                        for i in range(width):
                            seen_re += w_out[0, j, i] * r[first + i, b]
                            seen_im += w_out[1, j, i] * r[first + i, b]
                for a in range(senses):
                    out[sample, a] += 2.0 * (residues[0, j, a, b] * seen_re - residues[1, j, a, b] * seen_im)
                if not last:
                    next_re, next_im = z[0, j] * re - z[1, j] * im, z[0, j] * im + z[1, j] * re
                    for i in range(width):
                        next_re += w[0, j, i] * r[first + i, b]
                        next_im += w[1, j, i] * r[first + i, b]
                    x[0, j, b], x[1, j, b] = next_re, next_im


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
        _filter(
            real_parts(np.exp(poles * step_s)),
            real_parts(_weights(poles, nodes, step_s)),
            real_parts(np.exp(poles * late_s)),
            real_parts(_weights(poles, nodes, late_s)) if late else np.zeros((2, poles.size, nodes.size)),
            late,
            real_parts(residues),
            np.ascontiguousarray(remainder),
            out,
        )
    return out
