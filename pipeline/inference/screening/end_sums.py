"""End states of poles that held samples drive: sum_n z^{N-1-n} v[n] and its Taylor coefficients in log z.

    sum_n (N-1-n)^m / m! z^{N-1-n} v[n],    N-1-n = B i + k:  z^{B i} sum_l C(m, l) (B i)^{m-l} sum_k k^l z^k v

so that the sum over k < B is one matrix product for all poles.

Shapes: N samples, D drives, K poles, M orders, n blocks of B samples.
"""

from __future__ import annotations

from math import comb

import numpy as np

from ...arrays import ComplexArray, FloatArray

#: Samples B of a block.
_BLOCK = 256
#: log |z^n| from which on the samples of a long record do not count.
_FADED = -60.0


def reversed_blocks(drive: FloatArray) -> FloatArray:
    """The last sample first: blocks (D, n, B) of a drive (N, D), zeros at the end."""
    samples, drives = drive.shape
    out = np.zeros((drives, -(-samples // _BLOCK) * _BLOCK))
    out[:, :samples] = drive[::-1].T
    return out.reshape(drives, -1, _BLOCK)


def block_sums(blocks: FloatArray, log_z: ComplexArray, orders: int, first: int = 0) -> ComplexArray:
    """The sums (K, M, D) over ``blocks`` (D, n, B), which end ``first`` samples before the end of the record, for log z (K,)."""
    drives, count = blocks.shape[:2]
    power, k = np.arange(orders), np.arange(_BLOCK)
    table = np.exp(k[:, None] * log_z)[:, :, None] * (k[:, None] ** power)[:, None]
    inner = blocks.reshape(-1, _BLOCK) @ table.reshape(_BLOCK, -1).view(np.float64)
    inner_sums = inner.view(np.complex128).reshape(drives, count, log_z.size, orders)
    shift = float(first) + _BLOCK * np.arange(count)
    # (K, M, n) of the powers of the shift; (K, D, n, M) of the sums in the blocks.
    weights = np.exp(log_z[:, None] * shift)[:, None] * shift ** power[:, None]
    found = weights[:, None] @ inner_sums.transpose(2, 0, 1, 3)
    sums = np.zeros((log_z.size, orders, drives), dtype=np.complex128)
    for m in range(orders):
        for l in range(m + 1):
            sums[:, m] += comb(m, l) * found[:, :, m - l, l]
    return np.asarray(sums / np.cumprod(np.maximum(power, 1))[:, None])


def end_sums(drive: FloatArray, log_z: ComplexArray, orders: int, at_once: int) -> ComplexArray:
    """The sums (K, M, D) of a drive (N, D) for log z (K,); ``at_once`` samples of a long record have a reversed copy."""
    samples = drive.shape[0]
    sums = np.zeros((log_z.size, orders, drive.shape[1]), dtype=np.complex128)
    for first in range(0, samples, at_once):
        if float(np.max(log_z.real)) * first < _FADED:
            break
        own = drive[max(samples - first - at_once, 0) : samples - first]
        sums += block_sums(reversed_blocks(own), log_z, orders, first)
    return sums
