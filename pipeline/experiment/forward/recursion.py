"""Sums of first-order recursions under held samples, computed fast: the core of the modal bank and of the bandpass.

    x_k[n+1] = z_k x_k[n] + v[n],    y[n] = direct v[n] + Re sum_k w_k x_k[n]

A record is divided into L parts of M samples, which are computed side by side as vectors of the processor.  The state at the end
of a part follows from that of a part from rest, since the recursion is linear: x[M] = z^M x[0] + (x[M] from rest).

Shapes: N samples, P poles, D inputs, S outputs.  Signals in volts.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from ...arrays import ComplexArray, FloatArray

#: Parts L of a record, a constant for the compiler: 16 take three times as long, 64 and 96 take 1.3 times, 112 as long.
_LANES = 80
#: Samples of each part that pass all states while they are in the cache of the processor.
_AT_ONCE = 8
#: Bytes of a line of the cache: vectors that cross one take 1.3 times as long.
_LINE = 64


@dataclass(frozen=True, eq=False)
class Lanes:
    """A signal (N, D) of ``samples`` N as its parts (M, D/2, 2 L).

    Sample l M + n of a pair of inputs is [n, :, l] and [n, :, L + l].  Zeros are appended to the samples, and to the inputs
    where D is odd.
    """

    samples: int
    parts: FloatArray


def _aligned(shape: tuple[int, ...]) -> FloatArray:
    """An array whose values are not set, and which begins at a line of the cache."""
    size = math.prod(shape)
    whole = np.empty(size + _LINE // 8)
    first = -whole.ctypes.data % _LINE // 8
    return whole[first : first + size].reshape(shape)


def in_lanes(signal: FloatArray) -> Lanes:
    """``signal`` (N, D) as the parts that :func:`recursive` takes."""
    samples, inputs = signal.shape
    length, even = -(-samples // _LANES), inputs + inputs % 2
    padded = np.ascontiguousarray(signal)
    if signal.shape != (_LANES * length, even):
        padded = np.zeros((_LANES * length, even))
        padded[:samples, :inputs] = signal
    parts = _aligned((length, even, _LANES))
    parts[:] = padded.reshape(_LANES, length, even).transpose(1, 2, 0)
    return Lanes(samples, parts.reshape(length, even // 2, 2 * _LANES))


@njit(cache=True, fastmath={"contract", "reassoc", "nsz"})
def _run_lanes(
    z: ComplexArray,
    start: ComplexArray,
    weight: ComplexArray,
    direct: FloatArray,
    drive: FloatArray,
    states: FloatArray,
    out: FloatArray,
) -> None:
    """Fill ``out`` (M, 2 L), a pair of outputs, from the parts ``drive`` of D inputs, D even.

    ``states`` (P, D/2, 4 L) is where the states are kept, z (P,), start x[0] (P, D), weight w (2, P, D), direct (2, D).

    A first pass finds what each part adds to the states at its end, so that the second one starts each part with its states.
    The states of a pair of inputs, real and imaginary, are one row, and so are both outputs: the compiler then sees that they
    do not overlap.
    """
    length, pairs, _ = drive.shape
    states[:] = 0.0
    for p in range(z.size):
        a, b = z[p].real, z[p].imag
        size = abs(z[p])
        # Samples whose effect has died out at the end of their part are not needed: exp(-42) is below the rounding.
        first = max(0, length - 1 - int(-42.0 / np.log(size))) if 0.0 < size < 1.0 else 0
        for d in range(pairs):
            x = states[p, d]
            for n in range(first, length):
                v = drive[n, d]
                for k in range(_LANES):
                    r, i, rr, ii = x[k], x[_LANES + k], x[2 * _LANES + k], x[3 * _LANES + k]
                    x[k] = a * r - b * i + v[k]
                    x[_LANES + k] = a * i + b * r
                    x[2 * _LANES + k] = a * rr - b * ii + v[_LANES + k]
                    x[3 * _LANES + k] = a * ii + b * rr
            whole = z[p] ** length
            for h in range(2):
                state = start[p, 2 * d + h]
                for k in range(2 * h * _LANES, (2 * h + 1) * _LANES):
                    end = complex(x[k], x[_LANES + k])
                    x[k], x[_LANES + k] = state.real, state.imag
                    state = whole * state + end
    for begin in range(0, length, _AT_ONCE):
        stop = min(begin + _AT_ONCE, length)
        for n in range(begin, stop):
            o = out[n]
            o[:] = 0.0
            for d in range(pairs):
                v = drive[n, d]
                c, cc, f, ff = direct[0, 2 * d], direct[0, 2 * d + 1], direct[1, 2 * d], direct[1, 2 * d + 1]
                for k in range(_LANES):
                    o[k] += c * v[k] + cc * v[_LANES + k]
                    o[_LANES + k] += f * v[k] + ff * v[_LANES + k]
        for p in range(z.size):
            a, b = z[p].real, z[p].imag
            for d in range(pairs):
                x = states[p, d]
                w, ww, u, uu = (
                    weight[0, p, 2 * d],
                    weight[0, p, 2 * d + 1],
                    weight[1, p, 2 * d],
                    weight[1, p, 2 * d + 1],
                )
                c, e, cc, ee, f, g, ff, gg = w.real, -w.imag, ww.real, -ww.imag, u.real, -u.imag, uu.real, -uu.imag
                for n in range(begin, stop):
                    v, o = drive[n, d], out[n]
                    for k in range(_LANES):
                        r, i, rr, ii = x[k], x[_LANES + k], x[2 * _LANES + k], x[3 * _LANES + k]
                        o[k] += c * r + e * i + cc * rr + ee * ii
                        o[_LANES + k] += f * r + g * i + ff * rr + gg * ii
                        x[k] = a * r - b * i + v[k]
                        x[_LANES + k] = a * i + b * r
                        x[2 * _LANES + k] = a * rr - b * ii + v[_LANES + k]
                        x[3 * _LANES + k] = a * ii + b * rr


def recursive(
    signal: Lanes, z: ComplexArray, start: ComplexArray, weight: ComplexArray, direct: FloatArray
) -> FloatArray:
    """y[n] = direct v[n] + Re sum_k w_k x_k[n], (N, S), with x[n+1] = z x[n] + v[n].

    Parameters
    ----------
    signal : v (N, D).
    z : (P,) factors of a step.
    start : x[0] (P, D).
    weight, direct : w (S, P, D), and (S, D).
    """
    outputs, poles, inputs = weight.shape
    length, even = signal.parts.shape[0], 2 * signal.parts.shape[1]
    width = outputs + outputs % 2
    first, w, g = np.zeros((poles, even), complex), np.zeros((width, poles, even), complex), np.zeros((width, even))
    first[:, :inputs], w[:outputs, :, :inputs], g[:outputs, :inputs] = start, weight, direct
    out = np.empty((_LANES, length, outputs))
    pair, states = _aligned((length, 2 * _LANES)), _aligned((poles, even // 2, 4 * _LANES))
    for s in range(0, outputs, 2):
        _run_lanes(z, first, w[s : s + 2], g[s : s + 2], signal.parts, states, pair)
        own = out[:, :, s : s + 2]
        own[:] = pair.reshape(length, 2, _LANES)[:, : own.shape[2]].transpose(2, 0, 1)
    return out.reshape(_LANES * length, outputs)[: signal.samples]
