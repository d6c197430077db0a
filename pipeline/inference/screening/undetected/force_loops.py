"""Compiled loops over the motions of several devices and the forces along them.

Each sum has a fixed order, and products are not fused with sums: what a device gets depends neither on the other devices nor on
the place of a point in an array.  Points are in the order of ``forces.Motions``: cyclic, from a ``first`` point of the grid on.

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
def split_parts(envelopes: AnyComplexArray, first: int, device: int, out: RealArray) -> None:
    """Write real parts, then imaginary ones, of envelopes (C, n) to those of a device in ``out`` (C, B, 2, n)."""
    turn = envelopes.shape[1] - first
    for c in range(out.shape[0]):
        after, last = envelopes[c, first:], out[c, device, :, turn:]
        for i in range(turn):
            out[c, device, 0, i], out[c, device, 1, i] = after[i].real, after[i].imag
        for i in range(first):
            last[0, i], last[1, i] = envelopes[c, i].real, envelopes[c, i].imag


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


@njit(cache=True, error_model="numpy", fastmath={"nsz"})
def sums_of_squares(values: RealArray, counted: RealArray, first: int, count: int, out: FloatArray) -> None:
    """Write the sums of the squares of values (B, K, >= n') times ``counted`` (B, n), over n' = ``count`` points, to ``out`` (B, K).

    In the order of the grid, because a device alone has another ``first`` point; and in four sums, because a processor adds to
    one only every fourth cycle.
    """
    points, sums = counted.shape[1], np.empty(4)
    turn = min(points - first, count)
    for b in range(values.shape[0]):
        for k in range(values.shape[1]):
            sums[:] = 0.0
            for begin, end, number in ((turn, count, 0), (0, turn, first)):
                i = begin
                while i < end:
                    if (number + i - begin) % 4 == 0 and i + 4 <= end:
                        for lane in range(4):
                            sums[lane] += np.float64(counted[b, i + lane] * values[b, k, i + lane]) ** 2
                        i += 4
                    else:
                        sums[(number + i - begin) % 4] += np.float64(counted[b, i] * values[b, k, i]) ** 2
                        i += 1
            out[b, k] = (sums[0] + sums[1]) + (sums[2] + sums[3])


@njit(cache=True, error_model="numpy", fastmath={"nsz"})
def first_harmonic(values: RealArray, waves: RealArray, counted: RealArray, first: int, out: AnyComplexArray) -> None:
    """Write f_1 = (2/M) sum_m f_m e^{-i phi_m} of values (B, M, n'), times ``counted`` (B, n), to the grid of ``out`` (B, n).

    waves (1, M, 2): (2/M) cos phi_m, and -(2/M) sin phi_m.  Points beyond n' are zero.
    """
    count, points = values.shape[2], out.shape[1]
    parts = np.empty((1, 2, count), dtype=values.dtype)
    turn = min(points - first, count)
    for b in range(values.shape[0]):
        weighted_sums(values[b : b + 1], waves, 0, True, parts)
        out[b, max(0, first + count - points) : first] = 0.0
        out[b, min(points, first + count) :] = 0.0
        after, before = out[b, first:], out[b, :first]
        for i in range(turn):
            after[i] = complex(counted[b, i] * parts[0, 0, i], counted[b, i] * parts[0, 1, i])
        for i in range(count - turn):
            j = turn + i
            before[i] = complex(counted[b, j] * parts[0, 0, j], counted[b, j] * parts[0, 1, j])


@njit(cache=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz"})
def end_sums(envelopes: AnyComplexArray, decays: RealArray, out: AnyComplexArray) -> None:
    """Write sum_n l_n a_n of envelopes a (B, >= R, n) and factors l (B, 3, 2, n), real parts first, to ``out`` (B, 3, R).

    In single precision.  The sum may be taken in any order: it has as many terms for a device alone.
    """
    for b in range(out.shape[0]):
        for r in range(out.shape[2]):
            for k in range(out.shape[1]):
                real, imaginary = np.float32(0.0), np.float32(0.0)
                for i in range(envelopes.shape[2]):
                    x, y = envelopes[b, r, i].real, envelopes[b, r, i].imag
                    real += x * decays[b, k, 0, i] - y * decays[b, k, 1, i]
                    imaginary += x * decays[b, k, 1, i] + y * decays[b, k, 0, i]
                out[b, k, r] = complex(real, imaginary)
