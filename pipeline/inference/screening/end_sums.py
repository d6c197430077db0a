"""End states of poles that held samples drive: sum_n z^{N-1-n} v[n] and its Taylor coefficients in log z.

    sum_n (N-1-n)^m / m! z^{N-1-n} v[n],    N-1-n = B i + k:  z^{B i} sum_l C(m, l) (B i)^{m-l} sum_k k^l z^k v

so that the sum over k < B is one matrix product for all poles.

Shapes: N samples, D drives, K poles, M orders, n blocks of B samples.
"""

from __future__ import annotations

from functools import lru_cache
from math import factorial

import numpy as np

from ...arrays import ComplexArray, FloatArray

#: Samples B of a block.
_ROOT = 16
_BLOCK = _ROOT**2
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
    powers, mixture = _tables(orders)
    # z^k from z^{16 a} z^b, k = 16 a + b: an eighth of the exponentials.
    coarse, fine = np.exp(np.arange(_ROOT)[:, None] * (np.array([[[_ROOT]], [[1]]]) * log_z))
    table = (coarse[:, None] * fine).reshape(_BLOCK, -1, 1) * powers[:, None]
    inner = blocks.reshape(-1, _BLOCK) @ table.reshape(_BLOCK, -1).view(np.float64)
    inner_sums = inner.view(np.complex128).reshape(drives, count, log_z.size, orders)
    shift = float(first) + _BLOCK * np.arange(count)
    # (K, M, n) of the powers of the shift; (K, D, n, M) of the sums in the blocks.
    weights = np.exp(log_z[:, None] * shift)[:, None] * np.vander(shift, orders, increasing=True).T
    found = weights[:, None] @ inner_sums.transpose(2, 0, 1, 3)
    return np.asarray((found.reshape(log_z.size, drives, -1) @ mixture).transpose(0, 2, 1))


@lru_cache(maxsize=4)
def _tables(orders: int) -> tuple[FloatArray, FloatArray]:
    """k^m (B, M), and C(m, l) / m! from the power m - l of the shift and the power l of k to m, (M M, M)."""
    mixture = np.zeros((orders, orders, orders))
    for m in range(orders):
        for l in range(m + 1):
            mixture[m - l, l, m] = 1.0 / (factorial(l) * factorial(m - l))
    return np.vander(np.arange(float(_BLOCK)), orders, increasing=True), mixture.reshape(-1, orders)


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
