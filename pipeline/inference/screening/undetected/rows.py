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


def _real(spectra: ComplexArray, item: BandData) -> FloatArray:
    """(K, S, W) complex as (K, S, 2 W) real, hum lines projected out."""
    width = item.band.bins.size
    rows = np.empty((*spectra.shape[:-1], 2 * width))
    rows[..., :width], rows[..., width:] = spectra.real, spectra.imag
    n = item.nuisance
    if n.shape[1]:
        rows -= (rows @ n) @ n.T
    return rows


def whitened(spectra: ComplexArray, item: BandData, sigma_v: FloatArray) -> FloatArray:
    """Spectra (K, S, W) [V] of a record as rows (K, n) in sigmas, hum lines projected out; white noise has sigma (S,) [V].

    Raises
    ------
    numpy.linalg.LinAlgError : the covariance of the noise is not positive definite.
    """
    if item.noise is not None and item.noise.dependent.size:
        return _generalised(_real(spectra, item) * math.sqrt(2.0 / item.band.samples), item, item.noise)
    rows = stationary_rows(spectra, item, stationary_variance(item, sigma_v))
    return rows.reshape(rows.shape[0], -1)


def stationary_variance(item: BandData, sigma_v: FloatArray) -> FloatArray:
    """Largest variance (S, W) [V^2] that the noise of a record takes at each bin in the course of time."""
    if item.noise is None:
        return np.repeat(sigma_v[:, None] ** 2, item.band.bins.size, axis=1)
    if not item.noise.dependent.size:
        return item.noise.variance
    return np.asarray(item.noise.variance + item.noise.dependent[[0, 2]].max(axis=1)[:, None])


def stationary_rows(spectra: ComplexArray, item: BandData, variance: FloatArray) -> FloatArray:
    """Rows (K, S, 2 W) of spectra (K, S, W) [V] in units of noise of ``variance`` (S, W) [V^2]."""
    rows = _real(spectra, item)
    rows *= np.tile(math.sqrt(2.0 / item.band.samples) / np.sqrt(variance), 2)
    return rows


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
