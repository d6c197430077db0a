"""Spectra of a record as rows in units of its noise, for products between them.

    stationary noise:            rows of channel a and bin w:  sqrt(2/N) / s_a(w)
    noise that depends on time:  D^-1/2 (Q_0^T y_0, Q_1^T y_1), Q_a an orthonormal basis of the rows, D = cov (``whitening``)

Products of the second kind are those of generalised least squares within the span of the rows.

Shapes: K spectra, W bins, S = 2 senses.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.linalg import cholesky, qr, solve_triangular

from ....arrays import ComplexArray, FloatArray
from ..compressed import BandData
from ..whitening import BandNoise, covariance


def whitened(spectra: ComplexArray, item: BandData, sigma_v: FloatArray) -> FloatArray:
    """Spectra (K, S, W) [V] of a record as rows (K, n) in sigmas, hum lines projected out; white noise has sigma (S,) [V].

    Raises
    ------
    numpy.linalg.LinAlgError : the covariance of the noise is not positive definite.
    """
    width = item.band.bins.size
    rows = np.empty((*spectra.shape[:-1], 2 * width))
    rows[..., :width], rows[..., width:] = spectra.real, spectra.imag
    n = item.nuisance
    if n.shape[1]:
        rows -= (rows @ n) @ n.T
    scale = math.sqrt(2.0 / item.band.samples)
    if item.noise is not None and item.noise.dependent.size:
        return _generalised(rows * scale, item, item.noise)
    variance = sigma_v[:, None] ** 2 if item.noise is None else np.tile(item.noise.variance, 2)
    rows *= scale / np.sqrt(variance)
    return np.asarray(rows.reshape(rows.shape[0], -1))


def _generalised(rows: FloatArray, item: BandData, noise: BandNoise) -> FloatArray:
    """Rows (K, S, 2 W) [V] in sigmas of noise that depends on time, (K, 2 r)."""
    parts, bases = [], []
    for channel in (0, 1):
        own = rows[:, channel].T
        basis, triangle = qr(own / np.maximum(np.linalg.norm(own, axis=0), 1e-300), mode="economic", check_finite=False)
        seen = np.abs(np.diag(triangle)) > 1e-9
        bases.append(basis[:, seen])
        parts.append(basis[:, seen].T @ own)
    first = slice(0, bases[0].shape[1])
    second = slice(first.stop, None)
    pairs = covariance(np.concatenate(bases, axis=1), item.band, noise)
    crossed = pairs[1][first, second]
    whole = np.block([[pairs[0][first, first], crossed], [crossed.T, pairs[2][second, second]]])
    factor = cholesky(whole, lower=True)
    return np.asarray(solve_triangular(factor, np.concatenate(parts), lower=True).T)
