"""Compiled loops over responses and rows: one pass instead of ten over arrays of complex numbers.

    response         y_a(w) = sum_c T_ca(w) {f_c(w) - a_c - i w b_c}
    features         c_m = R h^m + m T h^(m - 1)
    read-out         y_a(w) = sum_r F_ar(w) S_r(w),    sum_d L_d(w) S_da(w)

Complex numbers are pairs of real ones inside of the loops: numba writes no vectors for complex numbers.

Shapes: K forces, 3 coordinates, M orders, S = 2 senses, D = 2 drives, W bins, n points of the grid.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from ....arrays import AnyComplexArray, ComplexArray, FloatArray, IntArray, RealArray


@njit(cache=True, error_model="numpy", fastmath={"contract", "nsz"})
def respond(
    force: AnyComplexArray,
    rows: IntArray,
    below: int,
    ringing: RealArray,
    omega: FloatArray,
    antialias: RealArray,
    poles: FloatArray,
    gain: RealArray,
    out: FloatArray,
) -> None:
    """Write y (K, S, 2 W), real parts before imaginary ones, to ``out``.

    T_ca = G sum_k g_kca / (i w - p_k) + g~_kca / (i w - p~_k)

    Parameters
    ----------
    force : transforms (R, n) of the envelopes of forces on a coordinate; the ``below`` last bins lie below the first.
    rows : (K, 3) which of them each force has on each coordinate; -1 where it has none.
    ringing : a and b (K, 3, 2), the motion at the end of the record, in units of the force.
    omega, antialias : w (W,) [rad/s], and G (2, W), real parts before imaginary ones.
    poles, gain : p (2, 3) [rad/s] and g (2, 3, 3, S) of each mode, coordinate and sense.
    """
    bins, points = omega.size, force.shape[1]
    kind = ringing.dtype
    resonance = np.empty((2, 6, bins), dtype=kind)
    for j in range(6):
        sign = 1.0 if j < 3 else -1.0
        # The distance to a pole needs all digits, the quotient does not.
        decay, own = -poles[0, j % 3], sign * poles[1, j % 3]
        for w in range(bins):
            apart = omega[w] - own
            inverse = 1.0 / (decay * decay + apart * apart)
            resonance[0, j, w], resonance[1, j, w] = decay * inverse, -apart * inverse
    transfer, total = np.empty((2, 3, 2, bins), dtype=kind), np.empty((2, bins), dtype=kind)
    for c in range(3):
        for s in range(2):
            total[:] = 0.0
            for j in range(6):
                a, b = gain[0, j % 3, c, s], gain[1, j % 3, c, s]
                if j > 2:
                    b = -b
                for w in range(bins):
                    total[0, w] += a * resonance[0, j, w] - b * resonance[1, j, w]
                    total[1, w] += a * resonance[1, j, w] + b * resonance[0, j, w]
            for w in range(bins):
                transfer[0, c, s, w] = antialias[0, w] * total[0, w] - antialias[1, w] * total[1, w]
                transfer[1, c, s, w] = antialias[0, w] * total[1, w] + antialias[1, w] * total[0, w]
    f, single = np.empty((2, 3, bins), dtype=kind), omega.astype(kind)
    for k in range(rows.shape[0]):
        for c in range(3):
            a, b, row = ringing[k, c, 0], ringing[k, c, 1], rows[k, c]
            for w in range(bins):
                f[0, c, w], f[1, c, w] = -a, -b * single[w]
            if row >= 0:
                for w in range(below):
                    f[0, c, w] += force[row, points - below + w].real
                    f[1, c, w] += force[row, points - below + w].imag
                for w in range(below, bins):
                    f[0, c, w] += force[row, w - below].real
                    f[1, c, w] += force[row, w - below].imag
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


@njit(cache=True, error_model="numpy")
def in_features(
    residues: ComplexArray,
    slopes: ComplexArray,
    weight: float,
    shifts: ComplexArray,
    source: tuple[int, ...],
    out: FloatArray,
) -> None:
    """Write R h^m + weight m T h^(m - 1) to ``out`` (k, C, 3, D, orders, 2), real part before imaginary one.

    Parameters
    ----------
    residues, slopes : R and T (k, 3, C, D).
    shifts, source : h of each mode [rad/s], and the mode that stands in each place.
    """
    for j in range(len(source)):
        mode = source[j]
        power, before = 1.0 + 0.0j, 0.0j
        for m in range(out.shape[4]):
            for k in range(residues.shape[0]):
                for c in range(residues.shape[2]):
                    for d in range(residues.shape[3]):
                        one = residues[k, mode, c, d] * power + weight * m * slopes[k, mode, c, d] * before
                        out[k, c, j, d, m, 0], out[k, c, j, d, m, 1] = one.real, one.imag
            power, before = power * shifts[mode], power


@njit(cache=True, error_model="numpy", fastmath={"contract", "nsz"})
def read_out(filters: RealArray, lags: RealArray, sensed: FloatArray, of_drives: FloatArray, out: FloatArray) -> None:
    """Write sum_r F_ksr(w) S_r(w), then sum_d L_ld(w) S_ds(w), (k + l, S, 2 W), to ``out``.

    All spectra have real parts before imaginary ones.

    Parameters
    ----------
    filters, lags : F (k, S, S, 2 W), and L (l, D, 2 W).
    sensed, of_drives : S (S, 2 W) [V], and its parts S_d (D, S, 2 W) [V].
    """
    count = filters.shape[0]
    out[: count + lags.shape[0]] = 0.0
    for s in range(sensed.shape[0]):
        for k in range(count):
            for r in range(sensed.shape[0]):
                _add_product(filters[k, s, r], sensed[r], out[k, s])
        for l in range(lags.shape[0]):
            for d in range(of_drives.shape[0]):
                _add_product(lags[l, d], of_drives[d, s], out[count + l, s])


@njit(cache=True, error_model="numpy", fastmath={"contract", "nsz"})
def _add_product(factor: RealArray, signal: FloatArray, out: FloatArray) -> None:
    """Add the product of two spectra (2 W,) to ``out`` (2 W,)."""
    bins = out.size // 2
    for w in range(bins):
        a, b, x, y = factor[w], factor[bins + w], signal[w], signal[bins + w]
        out[w] += a * x - b * y
        out[bins + w] += a * y + b * x


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
