"""Offset, trend and mains lines of a long record by least squares, without a matrix of all its samples.

    cos h phi (n_0 + k) = cos h phi n_0 cos h phi k - sin h phi n_0 sin h phi k,      phi = 2 pi f / f_s

so the waves of every block are those of the first one, turned; the normal equations are geometric series:

    sum_n z^n = (z^N - 1) / (z - 1),     sum_n n z^n = (z - N z^N + (N - 1) z^(N+1)) / (1 - z)^2,     z = e^(i m phi)

The waves are almost orthogonal over some hundred periods, so the normal equations lose no digits that count: the fit is that
of the orthonormal basis of ``lines`` to 1e-12 of the record (a test compares them).

Shapes: y (N, S) [V] with N samples and S senses, H harmonics, B samples of a block.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from ...arrays import FloatArray

#: Samples of a block: 26 MB of waves with 100 harmonics.
_BLOCK = 2**14


def long_fit(y: FloatArray, phase: float, harmonics: int, trend: bool) -> FloatArray:
    """The offset, trend and waves (N, S) [V] of y (N, S) [V]; ``phase`` is phi [rad] of a sample, of ``harmonics`` of it."""
    samples, orders = y.shape[0], np.arange(1, harmonics + 1)
    angle = phase * np.outer(np.arange(min(_BLOCK, samples)), orders)
    waves = np.concatenate([np.cos(angle), np.sin(angle)], axis=1)
    slope = (np.arange(samples) - (samples - 1) / 2.0) / samples
    sums = np.zeros((2 + 2 * harmonics, y.shape[1]))
    sums[0], sums[1] = y.sum(axis=0), slope @ y
    for first in range(0, samples, _BLOCK):
        own = y[first : first + _BLOCK]
        cosine, sine = np.split(waves[: own.shape[0]].T @ own, 2)
        c, s = (wave(phase * first * orders)[:, None] for wave in (np.cos, np.sin))
        sums[2:] += np.concatenate([c * cosine - s * sine, s * cosine + c * sine])
    kept = np.ones(sums.shape[0], dtype=bool)
    kept[1] = trend
    size = np.zeros(sums.shape)
    size[kept] = cho_solve(cho_factor(_gram(samples, phase, harmonics)[np.ix_(kept, kept)]), sums[kept])
    out = np.outer(slope, size[1]) + size[0]
    b, c_ = size[2 : 2 + harmonics], size[2 + harmonics :]
    for first in range(0, samples, _BLOCK):
        c, s = (wave(phase * first * orders)[:, None] for wave in (np.cos, np.sin))
        own = out[first : first + _BLOCK]
        own += waves[: own.shape[0]] @ np.concatenate([b * c + c_ * s, c_ * c - b * s])
    return out


def _gram(samples: int, phase: float, harmonics: int) -> FloatArray:
    """Products (2 + 2 H, 2 + 2 H) of offset, centred slope, cosines and sines over all samples."""
    z = np.exp(1j * phase * np.arange(1, 2 * harmonics + 1))
    last = z**samples
    whole = np.concatenate([[samples + 0j], (last - 1.0) / (z - 1.0)])
    ramp = (z - samples * last + (samples - 1) * last * z) / (1.0 - z) ** 2
    n = np.arange(1, harmonics + 1)
    minus, plus = np.abs(n[:, None] - n), n[:, None] + n
    sign = np.sign(n[:, None] - n)
    out = np.zeros((2 + 2 * harmonics, 2 + 2 * harmonics))
    cosines, sines = slice(2, 2 + harmonics), slice(2 + harmonics, None)
    out[0, 0], out[1, 1] = samples, (samples**2 - 1.0) / (12.0 * samples)
    out[0, cosines], out[0, sines] = whole[n].real, whole[n].imag
    centred = (ramp[:harmonics] - (samples - 1) / 2.0 * whole[n]) / samples
    out[1, cosines], out[1, sines] = centred.real, centred.imag
    out[cosines, cosines] = 0.5 * (whole[minus].real + whole[plus].real)
    out[sines, sines] = 0.5 * (whole[minus].real - whole[plus].real)
    # cos i sin j = (sin(i + j) - sin(i - j)) / 2
    out[cosines, sines] = 0.5 * (whole[plus].imag - sign * whole[minus].imag)
    return out + np.triu(out, 1).T
