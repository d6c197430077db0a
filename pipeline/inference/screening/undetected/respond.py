"""The response of a device to forces in the band, as a compiled loop: one pass instead of ten over arrays of complex numbers.

    y_a(w) = sum_c T_ca(w) {f_c(w) - a_c - i w b_c}

Complex numbers are pairs of real ones inside of the loops: numba writes no vectors for complex numbers.

Shapes: K forces, 3 coordinates, S = 2 senses, W bins, n points of the grid.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from ....arrays import AnyComplexArray, FloatArray, RealArray


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
