"""Sums of first-order recursions under held samples, computed fast: the core of the modal bank and of the bandpass.

    x_k[n+1] = z_k x_k[n] + v[n],    y[n] = direct v[n] + Re sum_k w_k x_k[n]

A record is divided into L parts of M samples, which are computed side by side as vectors of the processor.  The state at the end
of a part follows from that of a part from rest, since the recursion is linear: x[M] = z^M x[0] + (x[M] from rest).

Shapes: N samples, P poles, D inputs, S outputs.  Signals in volts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from ...arrays import ComplexArray, FloatArray

#: Parts of a record: 16 of 30,000 samples take three times as long, 48 take 1.2 times, and 256 as long.
_LANES = 128
#: Samples of each part that pass all states while they are in the cache of the processor.
_AT_ONCE = 8


@dataclass(frozen=True, eq=False)
class Lanes:
    """A signal (N, D) of ``samples`` N as its parts (M, D', L), D' even: sample l M + n is [n, :, l]; zeros are appended."""

    samples: int
    parts: FloatArray


def in_lanes(signal: FloatArray) -> Lanes:
    """``signal`` (N, D) as the parts that :func:`recursive` takes."""
    samples, inputs = signal.shape
    length = -(-samples // _LANES)
    padded = np.zeros((_LANES * length, inputs + inputs % 2))
    padded[:samples, :inputs] = signal
    return Lanes(samples, np.ascontiguousarray(padded.reshape(_LANES, length, -1).transpose(1, 2, 0)))


@njit(cache=True, fastmath={"contract", "reassoc", "nsz"})
def _run_lanes(
    z: ComplexArray,
    start: ComplexArray,
    weight: ComplexArray,
    direct: FloatArray,
    drive: FloatArray,
    out: FloatArray,
) -> None:
    """Fill ``out`` (M, 2, L) with direct v + Re sum w x, x[n+1] = z x[n] + v[n]; sample l M + n of the signals is [n, :, l].

    z (P,), start x[0] (P, D), weight w (2, P, D), direct (2, D), drive v (M, D, L), D even.  The L parts of a record are
    computed side by side, as vectors.  A first pass finds what each adds to the states at its end, so that the second one
    starts each part with its states.
    """
    length, drives, lanes = drive.shape
    re, im = np.zeros((z.size, drives, lanes)), np.zeros((z.size, drives, lanes))
    for p in range(z.size):
        a, b = z[p].real, z[p].imag
        size = abs(z[p])
        # Samples whose effect has died out at the end of their part are not needed: exp(-42) is below the rounding.
        first = max(0, length - 1 - int(-42.0 / np.log(size))) if 0.0 < size < 1.0 else 0
        for d in range(drives):
            r, i = re[p, d], im[p, d]
            for n in range(first, length):
                v = drive[n, d]
                for k in range(lanes):
                    x, y = r[k], i[k]
                    r[k] = a * x - b * y + v[k]
                    i[k] = a * y + b * x
            whole, state = z[p] ** length, start[p, d]
            for k in range(lanes):
                end = complex(r[k], i[k])
                r[k], i[k] = state.real, state.imag
                state = whole * state + end
    for begin in range(0, length, _AT_ONCE):
        stop = min(begin + _AT_ONCE, length)
        for n in range(begin, stop):
            for s in range(2):
                o = out[n, s]
                o[:] = 0.0
                for d in range(drives):
                    g, v = direct[s, d], drive[n, d]
                    for k in range(lanes):
                        o[k] += g * v[k]
        for p in range(z.size):
            a, b = z[p].real, z[p].imag
            for d in range(0, drives, 2):
                r, i, rr, ii = re[p, d], im[p, d], re[p, d + 1], im[p, d + 1]
                w, ww, u, uu = weight[0, p, d], weight[0, p, d + 1], weight[1, p, d], weight[1, p, d + 1]
                c, e, cc, ee, f, g, ff, gg = w.real, -w.imag, ww.real, -ww.imag, u.real, -u.imag, uu.real, -uu.imag
                for n in range(begin, stop):
                    v, vv, one, two = drive[n, d], drive[n, d + 1], out[n, 0], out[n, 1]
                    # Both drives and both senses in one loop: each state is loaded and stored once.
                    for k in range(lanes):
                        x, y, xx, yy = r[k], i[k], rr[k], ii[k]
                        one[k] += c * x + e * y + cc * xx + ee * yy
                        two[k] += f * x + g * y + ff * xx + gg * yy
                        r[k] = a * x - b * y + v[k]
                        i[k] = a * y + b * x
                        rr[k] = a * xx - b * yy + vv[k]
                        ii[k] = a * yy + b * xx


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
    length, even, lanes = signal.parts.shape
    width = outputs + outputs % 2
    first, w, g = np.zeros((poles, even), complex), np.zeros((width, poles, even), complex), np.zeros((width, even))
    first[:, :inputs], w[:outputs, :, :inputs], g[:outputs, :inputs] = start, weight, direct
    out = np.empty((lanes, length, outputs))
    two = np.empty((length, 2, lanes))
    for s in range(0, outputs, 2):
        _run_lanes(z, first, w[s : s + 2], g[s : s + 2], signal.parts, two)
        own = out[:, :, s : s + 2]
        own[:] = two[:, : own.shape[2]].transpose(2, 0, 1)
    return out.reshape(lanes * length, outputs)[: signal.samples]
