"""Poles of a matrix polynomial: where det A(z) = 0,  A(z) = I + A_1 z^-1 + .. + A_n z^-n.

Three methods that give the same poles:

companion_poles   all n S eigenvalues of the block companion matrix, by LAPACK
nearby_poles      those nearest to a point z0: block Arnoldi on (companion - z0)^-1 in O(n S^2) a step
refine            Newton's method on the matrix function (successive linear problems, Ruhe 1973):
                      z <- z + mu,   det(A(z) + mu A'(z)) = 0 with the smallest |mu|,
                  which, unlike Newton on det A(z), keeps its accuracy where two poles nearly coincide

Poles here are those of the discrete model, dimensionless; coefficients A is (n, S, S) as in ``ArxModel``.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from scipy.linalg import lapack

from ..arrays import ComplexArray, FloatArray

_ITERATIONS = 12


def companion_poles(A: FloatArray) -> ComplexArray:
    """All zeros (n S,) [1] of det A(z), unordered; A (n, S, S) [1]."""
    order, senses, _ = A.shape
    companion = np.zeros((order * senses, order * senses))
    companion[:senses] = -A.transpose(1, 0, 2).reshape(senses, -1)
    companion[senses:, :-senses] = np.eye((order - 1) * senses)
    return np.linalg.eigvals(companion).astype(np.complex128)


@njit(cache=True)
def polynomial_at(A: FloatArray, z: complex) -> tuple[ComplexArray, ComplexArray]:
    """P(z) = z^n A(z) and dP/dz by Horner; both (S, S) [1].  Well scaled around and inside the unit circle."""
    order, senses, _ = A.shape
    value = np.zeros((senses, senses), dtype=np.complex128)
    slope = np.zeros((senses, senses), dtype=np.complex128)
    for a in range(senses):
        value[a, a] = 1.0
    for k in range(order):
        for a in range(senses):
            for b in range(senses):
                slope[a, b] = slope[a, b] * z + value[a, b]
                value[a, b] = value[a, b] * z + A[k, a, b]
    return value, slope


@njit(cache=True)
def _shift_inverse(A: FloatArray, shift: complex, inverse: ComplexArray, b: ComplexArray, x: ComplexArray) -> None:
    """x = (companion - shift)^-1 b with inverse = P(shift)^-1; b, x (n, S).

    The lower rows give x_{k-1} = shift x_k + b_k, so x_k = shift^(n-k) v + c_k; the first row gives v = x_n.
    """
    order, senses, _ = A.shape
    x[order - 1] = 0.0
    for k in range(order - 1, 0, -1):
        for a in range(senses):
            x[k - 1, a] = shift * x[k, a] + b[k, a]
    total = np.empty(senses, dtype=np.complex128)
    for a in range(senses):
        total[a] = b[0, a] + shift * x[0, a]
    for k in range(order):
        for a in range(senses):
            for c in range(senses):
                total[a] += A[k, a, c] * x[k, c]
    v = np.zeros(senses, dtype=np.complex128)
    for a in range(senses):
        for c in range(senses):
            v[a] -= inverse[a, c] * total[c]
    for k in range(order - 1, -1, -1):
        for a in range(senses):
            x[k, a] += v[a]
            v[a] *= shift


@njit(cache=True)
def _block_arnoldi(A: FloatArray, shift: complex, inverse: ComplexArray, steps: int) -> ComplexArray:
    """Projection (steps, steps) of (companion - shift)^-1 on the Krylov space of the first S unit vectors.

    ``inverse`` is P(shift)^-1 (S, S).
    """
    order, senses, _ = A.shape
    length = order * senses
    basis = np.zeros((steps + senses, length), dtype=np.complex128)
    h = np.zeros((steps + senses, steps), dtype=np.complex128)
    x = np.empty((order, senses), dtype=np.complex128)
    for a in range(senses):
        basis[a, a] = 1.0
    for j in range(steps):
        _shift_inverse(A, shift, inverse, basis[j].reshape(order, senses), x)
        vector = x.reshape(length)
        filled = j + senses
        before = 0.0
        for m in range(length):
            before += vector[m].real ** 2 + vector[m].imag ** 2
        # Twice is enough (Giraud et al. 2005).
        for _ in range(2):
            for i in range(filled):
                product = 0.0j
                for m in range(length):
                    product += np.conj(basis[i, m]) * vector[m]
                h[i, j] += product
                for m in range(length):
                    vector[m] -= product * basis[i, m]
        norm = 0.0
        for m in range(length):
            norm += vector[m].real ** 2 + vector[m].imag ** 2
        if norm > 1e-28 * before:
            norm = np.sqrt(norm)
            h[filled, j] = norm
            for m in range(length):
                basis[filled, m] = vector[m] / norm
    return h[:steps]


def nearby_poles(A: FloatArray, centre: complex) -> ComplexArray:
    """Approximate zeros (K,) [1] of det A(z) nearest to ``centre``, by distance from it; A (n, S, S) [1].

    The nearest are good to 1e-4 or better and ready for :func:`refine`; the farthest are not.
    """
    order, senses, _ = A.shape
    steps = min(16 + order // 5, order * senses)
    factors, pivots, _ = lapack.zgetrf(polynomial_at(A, centre)[0])
    inverse, singular = lapack.zgetri(factors, pivots)
    if singular:
        return np.array([centre])
    projection = _block_arnoldi(A, centre, np.ascontiguousarray(inverse), steps)
    ritz: ComplexArray = np.linalg.eigvals(projection).astype(np.complex128)
    ritz = ritz[np.argsort(-np.abs(ritz))]
    return np.asarray(centre + 1.0 / ritz[np.abs(ritz) > 1e-8])


def _smallest_step(value: ComplexArray, slope: ComplexArray) -> complex:
    """mu [1] of smallest modulus with det(value + mu slope) = 0, both (S, S) [1]; inf where there is none.

    LAPACK is called directly: numba takes eight seconds to compile its own calls of it.
    """
    _, _, matrix, singular = lapack.zgesv(slope, -value)
    if singular or not np.isfinite(matrix.sum()):
        return complex(np.inf)
    steps, _, _, failed = lapack.zgeev(matrix, compute_vl=0, compute_vr=0)
    return complex(np.inf) if failed else complex(min(steps, key=abs))


@njit(cache=True, error_model="numpy")
def _smallest_step_of_two(value: ComplexArray, slope: ComplexArray) -> complex:
    """:func:`_smallest_step` of two senses in closed form: the smaller eigenvalue of -slope^-1 value.

    It is the determinant over the larger one, which does not cancel.  Not finite where there is none.
    """
    # Elimination with the larger pivot keeps the accuracy of a solver.
    i = 0 if abs(slope[0, 0]) >= abs(slope[1, 0]) else 1
    factor = slope[1 - i, 0] / slope[i, 0]
    corner = slope[1 - i, 1] - factor * slope[i, 1]
    c = -(value[1 - i, 0] - factor * value[i, 0]) / corner
    d = -(value[1 - i, 1] - factor * value[i, 1]) / corner
    a = (-value[i, 0] - slope[i, 1] * c) / slope[i, 0]
    b = (-value[i, 1] - slope[i, 1] * d) / slope[i, 0]
    middle, half = 0.5 * (a + d), 0.5 * (a - d)
    root = np.sqrt(half * half + b * c)
    larger = middle + root if abs(middle + root) >= abs(middle - root) else middle - root
    return 0.0j if larger == 0.0 else (a * d - b * c) / larger


@njit(cache=True)
def _refine_two(A: FloatArray, poles: ComplexArray, last: FloatArray) -> None:
    """:func:`refine` of two senses, in place of the seeds."""
    for i in range(poles.size):
        z, size = poles[i], np.inf
        for _ in range(_ITERATIONS):
            value, slope = polynomial_at(A, z)
            step = _smallest_step_of_two(value, slope)
            size = abs(step) if np.isfinite(step.real) and np.isfinite(step.imag) else np.inf
            if size == np.inf:
                break
            z += step
            if size < 1e-15:
                break
        poles[i] = z
        last[i] = size


def refine(A: FloatArray, seeds: ComplexArray) -> tuple[ComplexArray, FloatArray]:
    """Zeros (K,) [1] of det A(z) next to ``seeds`` (K,), and the size (K,) of the last correction of each; Ruhe 1973.

    The size is inf where a correction could not be computed.
    """
    poles = np.array(seeds, dtype=np.complex128)
    last = np.empty(seeds.size)
    if A.shape[1] == 2:
        _refine_two(np.ascontiguousarray(A), poles, last)
        return poles, last
    for i, seed in enumerate(seeds):
        z, size = complex(seed), np.inf
        for _ in range(_ITERATIONS):
            step = _smallest_step(*polynomial_at(A, z))
            size = abs(step)
            if not np.isfinite(size):
                break
            z += step
            if size < 1e-15:
                break
        poles[i] = z
        last[i] = size
    return poles, last
