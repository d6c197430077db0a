"""Time-frequency transform of a record: an orthonormal lapped transform (MDCT).

    c = DCT-IV of blocks of M samples, folded at their borders with the sine window (time-domain alias cancellation)

The transform is orthonormal: sum c^2 = sum y^2.  White noise of unit variance gives independent N(0, 1) coefficients, so the
energy of any set of cells is chi-square with as many degrees of freedom as there are cells.  Bin k of a block is centred at
(k + 1/2) f_s / (2 M).

Source: Princen, Johnson and Bradley, Proc. ICASSP (1987) 2161.  Shapes: N samples, S senses, K blocks, M bins.
"""

from __future__ import annotations

import numpy as np
from scipy.fft import dct

from ...arrays import FloatArray


def block_size(samples: int) -> int:
    """M, the power of two nearest to 3 sqrt(N): a linear sweep over 10 % of the band then moves about one bin per block."""
    return int(2 ** max(3, round(np.log2(3.0 * np.sqrt(samples)))))


def bin_frequencies(size: int, sample_rate_hz: float) -> FloatArray:
    """Centres (M,) [Hz] of the bins; ``size`` is M."""
    return np.asarray((np.arange(size) + 0.5) * sample_rate_hz / (2.0 * size), dtype=np.float64)


def lapped(y: FloatArray, size: int) -> FloatArray:
    """Coefficients (S, K, M) of y (N, S), in its unit; ``size`` is M.  The last block is padded with zeros."""
    blocks = _blocks(y, size)
    half = size // 2
    near, far = _window(half)
    # Samples before and after each border, ordered away from it.
    before, after = blocks[:, :-1, : half - 1 : -1].copy(), blocks[:, 1:, :half].copy()
    blocks[:, 1:, :half] = near * after + far * before
    blocks[:, :-1, : half - 1 : -1] = near * before - far * after
    return np.asarray(dct(blocks, type=4, norm="ortho", axis=-1))


def cell_variances(samples: int, size: int) -> FloatArray:
    """Variance (K,) of the coefficients of each block for white noise of unit variance; below 1 where zeros are padded."""
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
