"""Compiled residuals and Jacobian of the compressed data (``compressed``) as functions of the parameters.

    e_a = d_a - T_a c_a(x) [- T_01 c_1(x) for a = 0],     e_prior = offset - root m'

c_a are the residues of channel a times powers of the shift of each pole, (mode, drive, order, re/im): J = 48 real features.

The loops over arrays are written out: an expression of arrays takes numba seconds to compile, for the message of its errors.

Shapes: S = 2 senses, r rows of the triangles, P parameters: the cartesian ones of ``pipeline.device.gyro`` (12), and the
electrode mismatches (14).
"""

from __future__ import annotations

import numpy as np
from numba import njit

from ...arrays import ComplexArray, FloatArray
from ...device.gyro import cartesian_modes

#: Order of the Taylor series in the shift of a pole.
ORDER = 3
_ORDERS = ORDER + 1
FEATURES = 3 * 2 * _ORDERS * 2
#: Steps of the central differences of c(x): rad/s and 1/s, then logarithms and imbalances.
STEPS: FloatArray = np.array([1e-4] * 8 + [1e-5] * 6)


@njit(cache=True)
def coefficients(x: FloatArray, expansion: ComplexArray, out: FloatArray, shift: FloatArray) -> None:
    """Fill ``out`` (S, J) with c(x) as real numbers, and ``shift`` (3,) with |h_k| [rad/s]."""
    poles = np.empty(3, dtype=np.complex128)
    residues = np.empty((3, 2, 2), dtype=np.complex128)
    cartesian_modes(x, poles, residues)
    crossed = abs(poles[0] - expansion[1]) + abs(poles[1] - expansion[0])
    straight = abs(poles[0] - expansion[0]) + abs(poles[1] - expansion[1])
    for k in range(3):
        source = k
        if crossed < straight and k < 2:
            source = 1 - k
        h = poles[source] - expansion[k]
        shift[k] = abs(h)
        for a in range(2):
            for d in range(2):
                c = residues[source, a, d]
                for m in range(_ORDERS):
                    j = ((k * 2 + d) * _ORDERS + m) * 2
                    out[a, j] = c.real
                    out[a, j + 1] = c.imag
                    c = c * h


@njit(cache=True, fastmath={"contract", "reassoc", "nsz"})
def _triangle_times(triangle: FloatArray, c: FloatArray, out: FloatArray) -> None:
    rows, columns = triangle.shape
    for i in range(rows):
        total = 0.0
        for j in range(i, columns):
            total += triangle[i, j] * c[j]
        out[i] = total


@njit(cache=True)
def allowed(x: FloatArray) -> bool:
    """Support of the prior at x (P,) [rad/s, 1/s, 1]: C positive semidefinite, up-down mode damped, imbalances below 1."""
    return bool(
        x[3] > 0.0
        and x[4] * x[4] + x[5] * x[5] <= x[3] * x[3]
        and x[7] > 0.0
        and 4.0 * x[6] * x[6] > x[7] * x[7]
        and abs(x[10]) < 1.0
        and abs(x[11]) < 1.0
        and (x.size == 12 or (abs(x[10] + x[13]) < 1.0 and abs(x[11] + x[12]) < 1.0))
        and x[0] * x[0] > x[1] * x[1] + x[2] * x[2]
        and x[6] > 0.0
    )


@njit(cache=True)
def _model_rows(c: FloatArray, triangle: FloatArray, cross: FloatArray, out: FloatArray) -> None:
    """T c (2 r,) in sigmas from coefficients c (2, J)."""
    rows = triangle.shape[1]
    for a in range(2):
        _triangle_times(triangle[a], c[a], out[a * rows : (a + 1) * rows])
    for i in range(cross.shape[0]):
        for j in range(cross.shape[1]):
            out[i] += cross[i, j] * c[1, j]


@njit(cache=True)
def residual_rows(
    x: FloatArray,
    expansion: ComplexArray,
    triangle: FloatArray,
    cross: FloatArray,
    data: FloatArray,
    prior_root: FloatArray,
    prior_offset: FloatArray,
) -> tuple[FloatArray, float]:
    """Residuals data - model (2 r,) in sigmas at x (P,), then those of the prior, and the largest |h| [rad/s]."""
    rows = triangle.shape[1]
    c = np.empty((2, FEATURES))
    shift = np.empty(3)
    coefficients(x, expansion, c, shift)
    out = np.empty(2 * rows + prior_offset.size)
    _model_rows(c, triangle, cross, out)
    for a in range(2):
        for i in range(rows):
            out[a * rows + i] = data[a, i] - out[a * rows + i]
    for i in range(prior_offset.size):
        out[2 * rows + i] = prior_offset[i] - prior_root[i, 0] * x[12] - prior_root[i, 1] * x[13]
    return out, max(shift[0], shift[1], shift[2])


@njit(cache=True)
def jacobian_rows(
    x: FloatArray,
    expansion: ComplexArray,
    triangle: FloatArray,
    cross: FloatArray,
    data: FloatArray,
    prior_root: FloatArray,
    prior_offset: FloatArray,
) -> FloatArray:
    """d model / d x (2 r [+ 2], P), in sigmas per unit of x (P,), by central differences of c(x)."""
    rows = triangle.shape[1]
    size = x.size
    c_plus = np.empty((2, FEATURES))
    c_minus = np.empty((2, FEATURES))
    slope = np.empty((2, FEATURES, size))
    shift = np.empty(3)
    out = np.zeros((2 * rows + prior_offset.size, size))
    for i in range(size):
        moved = x.copy()
        moved[i] = x[i] + STEPS[i]
        coefficients(moved, expansion, c_plus, shift)
        moved[i] = x[i] - STEPS[i]
        coefficients(moved, expansion, c_minus, shift)
        for a in range(2):
            for j in range(FEATURES):
                slope[a, j, i] = (c_plus[a, j] - c_minus[a, j]) / (2.0 * STEPS[i])
    for a in range(2):
        model = np.dot(triangle[a], slope[a])
        for j in range(rows):
            for i in range(size):
                out[a * rows + j, i] = model[j, i]
    if cross.shape[0] > 0:
        model = np.dot(cross, slope[1])
        for j in range(cross.shape[0]):
            for i in range(size):
                out[j, i] += model[j, i]
    for i in range(prior_offset.size):
        for j in range(2):
            out[2 * rows + i, 12 + j] = prior_root[i, j]
    return out
