"""Compiled loops over forces and rows: one pass instead of ten over arrays of complex numbers.

    first harmonic   f_1 = (2/M) sum_m f_m e^{-i phi_m}
    response         y_a(w) = sum_c T_ca(w) {f_c(w) - a_c - i w b_c}

Complex numbers are pairs of real ones inside of the loops: numba writes no vectors for complex numbers.

Shapes: K forces, 3 coordinates, M phases, S = 2 senses, W bins, n points of the grid, n' of them used.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from ....arrays import AnyComplexArray, FloatArray, IntArray, RealArray


@njit(cache=True, error_model="numpy", fastmath={"contract", "nsz"})
def first_harmonic(values: RealArray, waves: RealArray, kept: IntArray, out: AnyComplexArray) -> None:
    """Write f_1 of values (K, 3, M, n') to the points ``kept`` (n',) of ``out`` (K, 3, n).

    waves (2, M): (2/M) cos phi_m, and -(2/M) sin phi_m.
    """
    real, imaginary = np.empty(kept.size, dtype=values.dtype), np.empty(kept.size, dtype=values.dtype)
    for k in range(values.shape[0]):
        for c in range(3):
            real[:], imaginary[:] = 0.0, 0.0
            for m in range(waves.shape[1]):
                cosine, sine = waves[0, m], waves[1, m]
                for i in range(kept.size):
                    real[i] += cosine * values[k, c, m, i]
                    imaginary[i] += sine * values[k, c, m, i]
            for i in range(kept.size):
                out[k, c, kept[i]] = complex(real[i], imaginary[i])


@njit(cache=True, error_model="numpy", fastmath={"contract", "nsz"})
def respond(
    force: AnyComplexArray, below: int, ringing: RealArray, omega: RealArray, transfer: RealArray, out: FloatArray
) -> None:
    """Write y (K, S, 2 W), real parts before imaginary ones, to ``out``.

    Parameters
    ----------
    force : transforms (K, 3, n) of the envelopes of the forces; the ``below`` last bins lie below the first.
    ringing : a and b (K, 3, 2), the motion at the end of the record, in units of the force.
    omega : w (W,) [rad/s].
    transfer : T (2, 3, S, W), real parts before imaginary ones.
    """
    bins, points = omega.size, force.shape[2]
    f = np.empty((2, 3, bins), dtype=np.float32)
    for k in range(force.shape[0]):
        for c in range(3):
            a, b = ringing[k, c, 0], ringing[k, c, 1]
            for w in range(bins):
                at = w - below if w >= below else points - below + w
                f[0, c, w] = force[k, c, at].real - a
                f[1, c, w] = force[k, c, at].imag - b * omega[w]
        for s in range(2):
            for w in range(bins):
                out[k, s, w] = (
                    transfer[0, 0, s, w] * f[0, 0, w]
                    - transfer[1, 0, s, w] * f[1, 0, w]
                    + transfer[0, 1, s, w] * f[0, 1, w]
                    - transfer[1, 1, s, w] * f[1, 1, w]
                    + transfer[0, 2, s, w] * f[0, 2, w]
                    - transfer[1, 2, s, w] * f[1, 2, w]
                )
                out[k, s, bins + w] = (
                    transfer[0, 0, s, w] * f[1, 0, w]
                    + transfer[1, 0, s, w] * f[0, 0, w]
                    + transfer[0, 1, s, w] * f[1, 1, w]
                    + transfer[1, 1, s, w] * f[0, 1, w]
                    + transfer[0, 2, s, w] * f[1, 2, w]
                    + transfer[1, 2, s, w] * f[0, 2, w]
                )


@njit(cache=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz"})
def products_within(rows: FloatArray, fit: int, effects: IntArray, levels: FloatArray, out: FloatArray) -> None:
    """Write the products of rows (K, S, R) from number ``fit`` on to ``out`` (K, K), channels times ``levels`` (S,) [1/V^2].

    Only of rows of the same of the ``effects`` (K - fit,).
    """
    for k in range(fit, rows.shape[0]):
        for l in range(fit, k + 1):
            if effects[k - fit] != effects[l - fit]:
                continue
            out[k, l] = 0.0
            for a in range(levels.size):
                total = 0.0
                for w in range(rows.shape[2]):
                    total += rows[k, a, w] * rows[l, a, w]
                out[k, l] += total * levels[a]
            out[l, k] = out[k, l]
