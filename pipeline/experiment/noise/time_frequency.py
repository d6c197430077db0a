"""A record in the plane of time and frequency, by an orthonormal lapped transform.

    c = DCT-IV of blocks of M samples, folded at their borders by the sine window (time-domain alias cancellation)

The transform is orthonormal: sum c^2 = sum y^2, and white noise of unit variance makes every c an N(0, 1) of its own, so the
energies of any cells are chi-square with as many degrees of freedom as there are cells.  Bin k of a block lies at
(k + 1/2) f_s / (2 M).

Source: Princen, Johnson and Bradley, Proc. ICASSP (1987) 2161.  Shapes: N samples, S senses, K blocks, M bins.
"""

from __future__ import annotations

import numpy as np
from scipy.fft import dct

from ...arrays import FloatArray


def block_size(samples: int) -> int:
    """M = 2^m next to 3 sqrt(N): a sweep through a few percent of the band then moves about one bin a block."""
    return int(2 ** max(3, round(np.log2(3.0 * np.sqrt(samples)))))


def bin_frequencies(size: int, sample_rate_hz: float) -> FloatArray:
    """(M,) centres [Hz] of the bins."""
    return np.asarray((np.arange(size) + 0.5) * sample_rate_hz / (2.0 * size), dtype=np.float64)


def lapped(y: FloatArray, size: int) -> FloatArray:
    """(N, S) samples -> (S, K, M) coefficients; the last block is filled up with zeros."""
    blocks = _blocks(y, size)
    half = size // 2
    near, far = _window(half)
    # Samples before and after each border, outwards from it.
    before, after = blocks[:, :-1, : half - 1 : -1].copy(), blocks[:, 1:, :half].copy()
    blocks[:, 1:, :half] = near * after + far * before
    blocks[:, :-1, : half - 1 : -1] = near * before - far * after
    return np.asarray(dct(blocks, type=4, norm="ortho", axis=-1))


def cell_variances(samples: int, size: int) -> FloatArray:
    """(K,) variance of the coefficients of a block under white noise of unit variance; below 1 only where zeros fill up."""
    blocks = _blocks(np.ones((samples, 1)), size)[0]
    half = size // 2
    near, far = _window(half)
    before, after = blocks[:-1, : half - 1 : -1].copy(), blocks[1:, :half].copy()
    blocks[1:, :half] = near**2 * after + far**2 * before
    blocks[:-1, : half - 1 : -1] = near**2 * before + far**2 * after
    return np.asarray(blocks.mean(axis=-1))


def _blocks(y: FloatArray, size: int) -> FloatArray:
    samples, senses = y.shape
    count = -(-samples // size)
    filled = np.zeros((senses, count * size))
    filled[:, :samples] = y.T
    return filled.reshape(senses, count, size)


def _window(half: int) -> tuple[FloatArray, FloatArray]:
    angle = 0.25 * np.pi * (1.0 + (np.arange(half) + 0.5) / half)
    return np.sin(angle), np.cos(angle)
