"""Compiled loops over the motions of several devices and the forces along them.

Each sum has a fixed order, and products are not fused with sums: what a device gets depends neither on the other devices nor on
the place of a point in an array.  Points are in the order of ``motions.Motions``: cyclic, from a ``first`` point of the grid on.

Shapes: B devices, C channels, R envelopes, 3 modes, n points of the grid, n' of them that are used.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from ....arrays import AnyComplexArray, BoolArray, FloatArray, RealArray


@njit(cache=True, error_model="numpy", fastmath={"nsz"})
def loud_points(velocities: AnyComplexArray, quiet: np.float32, out: BoolArray) -> None:
    """Write whether the sum of the amplitudes of velocities (C, n) is above ``quiet`` of its largest, to ``out`` (n,)."""
    speed = np.zeros(out.size, dtype=np.float32)
    for c in range(velocities.shape[0]):
        for i in range(out.size):
            real, imaginary = velocities[c, i].real, velocities[c, i].imag
            speed[i] += np.sqrt(real * real + imaginary * imaginary)
    least = quiet * speed.max()
    for i in range(out.size):
        out[i] = speed[i] > least


@njit(cache=True, error_model="numpy")
def split_parts(envelopes: RealArray, first: int, device: int, out: RealArray) -> None:
    """Write real parts, then imaginary ones, of envelopes (C, 2 n), in turn, to those of a device in ``out`` (C, B, 2, n)."""
    for c in range(out.shape[0]):
        after, last = envelopes[c, 2 * first :], out[c, device, :, out.shape[3] - first :]
        for i in range(after.size // 2):
            out[c, device, 0, i], out[c, device, 1, i] = after[2 * i], after[2 * i + 1]
        for i in range(first):
            last[0, i], last[1, i] = envelopes[c, 2 * i], envelopes[c, 2 * i + 1]


@njit(cache=True, error_model="numpy", fastmath={"nsz"})
def weighted_sums(values: RealArray, weights: RealArray, begin: int, fresh: bool, out: RealArray) -> None:
    """Add sum_k weights (B, K, M) values (B, K, >= n') to the channels from ``begin`` on of ``out`` (B, >= M, n').

    ``fresh``: write them instead.  Weights of one device are those of all.
    """
    points, most = out.shape[2], values.shape[1]
    for b in range(values.shape[0]):
        own = b if weights.shape[0] > 1 else 0
        for m in range(weights.shape[2]):
            k = 0
            if fresh and most % 2:
                for i in range(points):
                    out[b, begin + m, i] = weights[own, 0, m] * values[b, 0, i]
                k = 1
            elif fresh:
                one, other = weights[own, 0, m], weights[own, 1, m]
                for i in range(points):
                    out[b, begin + m, i] = one * values[b, 0, i] + other * values[b, 1, i]
                k = 2
            elif most % 2:
                for i in range(points):
                    out[b, begin + m, i] += weights[own, 0, m] * values[b, 0, i]
                k = 1
            while k < most:
                # Two at once: half as many passes over the sums.
                one, other = weights[own, k, m], weights[own, k + 1, m]
                for i in range(points):
                    out[b, begin + m, i] += one * values[b, k, i] + other * values[b, k + 1, i]
                k += 2


@njit(cache=True, error_model="numpy", fastmath={"reassoc", "nsz"})
def _sum(values: FloatArray) -> float:
    """The sum of values, in an order that depends on their number only."""
    total = 0.0
    for i in range(values.size):
        total += values[i]
    return total


@njit(cache=True, error_model="numpy", fastmath={"nsz"})
def sums_of_squares(values: RealArray, counted: RealArray, first: int, count: int, out: FloatArray) -> None:
    """Write sums over n' = ``count`` points of the squares of values (B, K, >= n') times ``counted`` (B, n) to ``out`` (B, K).

    All points of the grid are summed in its order, because a device alone has another ``first`` point and another n'.
    """
    squares = np.zeros(counted.shape[1])
    turn = min(squares.size - first, count)
    after = squares[first:]
    for b in range(values.shape[0]):
        ahead = counted[b, turn:]
        for k in range(values.shape[1]):
            last = values[b, k, turn:]
            for i in range(turn):
                after[i] = np.float64(counted[b, i] * values[b, k, i]) ** 2
            for i in range(count - turn):
                squares[i] = np.float64(ahead[i] * last[i]) ** 2
            out[b, k] = _sum(squares)


@njit(cache=True, error_model="numpy", fastmath={"nsz"})
def first_harmonic(
    values: RealArray, waves: RealArray, counted: RealArray, first: int, row: int, out: RealArray
) -> None:
    """Write f_1 = (2/M) sum_m f_m e^{-i phi_m} of values (B, M, n'), times ``counted`` (B, n), to a row of ``out`` (B, R, 2 n).

    waves (1, M, 2): (2/M) cos phi_m, and -(2/M) sin phi_m.  ``out``: real and imaginary parts in turn, in the order of the grid.
    Points beyond n' are zero.
    """
    count, points = values.shape[2], out.shape[2] // 2
    parts = np.empty((1, 2, count), dtype=values.dtype)
    turn = min(points - first, count)
    for b in range(values.shape[0]):
        weighted_sums(values[b : b + 1], waves, 0, True, parts)
        out[b, row, 2 * max(0, first + count - points) : 2 * first] = 0.0
        out[b, row, 2 * min(points, first + count) :] = 0.0
        after = out[b, row, 2 * first :]
        for i in range(turn):
            after[2 * i] = counted[b, i] * parts[0, 0, i]
            after[2 * i + 1] = counted[b, i] * parts[0, 1, i]
        ahead, real, imaginary = counted[b, turn:], parts[0, 0, turn:], parts[0, 1, turn:]
        for i in range(count - turn):
            out[b, row, 2 * i], out[b, row, 2 * i + 1] = ahead[i] * real[i], ahead[i] * imaginary[i]


@njit(cache=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz"})
def end_sums(envelopes: AnyComplexArray, coarse: RealArray, fine: RealArray, out: AnyComplexArray) -> None:
    """Write sum_n l_n a_n of envelopes a (B, >= R, n) to ``out`` (B, 3, R), in single precision.

    The factors l, as many from the end as there are points, are products of coarse ones (B, 3, 2, C) and fine ones (B, 3, 2, F),
    real parts first: l = coarse_i fine_j at the place i F + j.  Sums may be taken in any order: a device alone has as many terms.
    """
    points, size = envelopes.shape[2], fine.shape[3]
    factors = np.empty((2, coarse.shape[3] * size), dtype=np.float32)
    real, imaginary = factors[0, factors.shape[1] - points :], factors[1, factors.shape[1] - points :]
    for b in range(out.shape[0]):
        for k in range(out.shape[1]):
            for i in range(coarse.shape[3]):
                c, d = coarse[b, k, 0, i], coarse[b, k, 1, i]
                for j in range(size):
                    factors[0, i * size + j] = c * fine[b, k, 0, j] - d * fine[b, k, 1, j]
                    factors[1, i * size + j] = c * fine[b, k, 1, j] + d * fine[b, k, 0, j]
            for r in range(out.shape[2]):
                x, y = np.float32(0.0), np.float32(0.0)
                for i in range(points):
                    x += envelopes[b, r, i].real * real[i] - envelopes[b, r, i].imag * imaginary[i]
                    y += envelopes[b, r, i].real * imaginary[i] + envelopes[b, r, i].imag * real[i]
                out[b, k, r] = complex(x, y)
