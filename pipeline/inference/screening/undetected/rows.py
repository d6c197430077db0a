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


def write_real(spectra: ComplexArray, out: FloatArray, factor: float = 1.0) -> None:
    """Write ``factor`` times spectra (.., W) as real numbers to ``out`` (.., 2 W): real parts before imaginary ones."""
    width = spectra.shape[-1]
    np.multiply(spectra.real, factor, out=out[..., :width])
    np.multiply(spectra.imag, factor, out=out[..., width:])


def stationary_variance(item: BandData, sigma_v: FloatArray) -> FloatArray:
    """Largest variance (S, W) [V^2] that the noise of a record takes at each bin in the course of time."""
    if item.noise is None:
        return np.repeat(sigma_v[:, None] ** 2, item.band.bins.size, axis=1)
    if not item.noise.dependent.size:
        return item.noise.variance
    return np.asarray(item.noise.variance + item.noise.dependent[[0, 2]].max(axis=1)[:, None])


def without_hum(rows: FloatArray, nuisance: FloatArray) -> FloatArray:
    """Rows (K, S, 2 W) [V] less their part in a ``nuisance`` basis (2 W, L)."""
    if not nuisance.shape[1]:
        return rows
    flat = rows.reshape(-1, rows.shape[2])
    left = (flat @ nuisance) @ nuisance.T
    np.subtract(flat, left, out=left)
    return left.reshape(rows.shape)


def record_weight(item: BandData, variance: FloatArray) -> FloatArray:
    """sqrt(2/N) / s (S, W), which turns volts into sigmas of noise of ``variance`` (S, W) [V^2]."""
    return np.asarray(math.sqrt(2.0 / item.band.samples) / np.sqrt(variance))


def hum_of(rows: FloatArray, nuisance: FloatArray) -> FloatArray:
    """Parts (K, S, L) of rows (K, S, 2 W) in a ``nuisance`` basis (2 W, L)."""
    return np.asarray(rows.reshape(-1, rows.shape[2]) @ nuisance).reshape(*rows.shape[:2], -1)


def white_products(rows: FloatArray, hum: FloatArray, item: BandData, variance: FloatArray) -> FloatArray:
    """Products (K, K) of rows (K, S, 2 W) [V] in sigmas of white noise, their parts ``hum`` (K, S, L) left out.

    The projection is that of the products, y'z - (n'y)'(n'z), so the rows are not touched.  The symmetric product of all rows
    takes less time than the smaller products that are needed of it.
    """
    out = np.zeros((rows.shape[0], rows.shape[0]))
    for a, own_variance in enumerate(variance[:, 0]):
        own = rows[:, a] @ rows[:, a].T
        own -= hum[:, a] @ hum[:, a].T
        own *= 2.0 / item.band.samples / own_variance
        out += own
    return out


def products_of(rows: FloatArray, item: BandData, noise: BandNoise, variance: FloatArray) -> FloatArray:
    """Products (K, K) of rows (K, S, 2 W) [V] in sigmas of noise that is not white, hum lines projected out.

    Raises
    ------
    numpy.linalg.LinAlgError : the covariance of noise that depends on the signal is not positive definite.
    """
    depends = noise.dependent.size > 0
    flat = generalised_rows(rows, item, noise) if depends else stationary_rows(rows, item, variance)
    return np.asarray(flat @ flat.T)


def stationary_rows(rows: FloatArray, item: BandData, variance: FloatArray) -> FloatArray:
    """Rows (K, 2 S W) of rows (K, S, 2 W) [V] in units of noise of ``variance`` (S, W) [V^2], hum lines projected out."""
    weighted = without_hum(rows, item.nuisance) * np.tile(record_weight(item, variance), 2)
    return np.asarray(weighted.reshape(rows.shape[0], -1))


def generalised_rows(spectra: FloatArray, item: BandData, noise: BandNoise) -> FloatArray:
    """Rows (K, 2 r) of rows (K, S, 2 W) [V] in sigmas of noise that depends on time, hum lines projected out.

    Raises
    ------
    numpy.linalg.LinAlgError : the covariance of the noise is not positive definite.
    """
    scale = math.sqrt(2.0 / item.band.samples)
    parts, bases = [], []
    for channel in (0, 1):
        own = spectra[:, channel].T * scale
        own -= item.nuisance @ (item.nuisance.T @ own)
        unit = own / np.maximum(np.linalg.norm(own, axis=0), 1e-300)
        # Without pivots a column that depends on others takes a direction that later ones need: p-values moved by a half.
        basis, triangle, _ = qr(unit, mode="economic", pivoting=True, check_finite=False)
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
