"""Spectra of a record as rows in units of its noise, for products between them.

    stationary noise:            rows of channel a and bin w:  sqrt(2/N) / s_a(w)
    noise that depends on time:  D^-1/2 (Q_0^T y_0, Q_1^T y_1), Q_a an orthonormal basis of the rows, D = cov (``whitening``)

The hum lines are taken out of the rows before (:func:`take_out_hum`).
Products of the second kind are those of generalised least squares within the span of the rows.

Shapes: K spectra, W bins, S = 2 senses.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.linalg import cholesky, qr, solve_triangular

from ....arrays import FloatArray, IntArray
from ..compressed import BandData
from ..whitening import BandNoise, covariance
from .loops import products_within

#: Part of a unit row that counts as rounding, of which single precision leaves 3e-8: it would be a direction of its own, in which
#: noise that depends on time explains other rows.  Rows of the library have about 3e-3 of their own at least.
_ROUNDING = 1e-6
#: Rows of a tile of products.
_TILE = 8
#: Size of a unit vector of a hum line at a bin that counts as none: a line of 1e5 sigmas leaves 1e-6 of them there.
_LEAKED = 1e-11


def stationary_variance(item: BandData, sigma_v: FloatArray) -> FloatArray:
    """Largest variance (S, W) [V^2] that the noise of a record takes at each bin in the course of time."""
    if item.noise is None:
        return np.repeat(sigma_v[:, None] ** 2, item.band.bins.size, axis=1)
    if not item.noise.dependent.size:
        return item.noise.variance
    return np.asarray(item.noise.variance + item.noise.dependent[[0, 2]].max(axis=1)[:, None])


def take_out_hum(rows: FloatArray, nuisance: FloatArray) -> None:
    """Take their part in a ``nuisance`` basis (2 W, L) out of rows (K, S, 2 W) [V], in place.

    Lines that fall on bins, as those of a record of whole periods do, leave all other bins as they are.
    """
    if not nuisance.shape[1]:
        return
    touched = np.flatnonzero(np.einsum("wl,wl->w", nuisance, nuisance) > _LEAKED**2)
    basis = nuisance[touched]
    own = rows[:, :, touched]
    rows[:, :, touched] = own - (own @ basis) @ basis.T


def record_weight(item: BandData, variance: FloatArray) -> FloatArray:
    """sqrt(2/N) / s (S, W), which turns volts into sigmas of noise of ``variance`` (S, W) [V^2]."""
    return np.asarray(math.sqrt(2.0 / item.band.samples) / np.sqrt(variance))


def white_products(rows: FloatArray, fit: int, effects: IntArray, item: BandData, variance: FloatArray) -> FloatArray:
    """Products (K, K) of rows (K, S, 2 W) [V] in sigmas of white noise: with the first ``fit`` rows, and within ``effects``.

    effects (K - fit,): a number for each of the other rows, equal for those of one effect; all other products are zero.
    """
    count, levels = rows.shape[0], 2.0 / item.band.samples / variance[:, 0]
    # Whole tiles of a product take less time than a part of one.
    tall = min(-(-fit // _TILE) * _TILE, count)
    out = np.zeros((count, count))
    for a, level in enumerate(levels):
        # This way round takes nine tenths of the time.
        out[:, :tall] += (rows[:, a] @ rows[:tall, a].T) * level
    out[:tall, tall:] = out[tall:, :tall].T
    products_within(rows, fit, effects, levels, out)
    return out


def products_of(rows: FloatArray, item: BandData, noise: BandNoise, variance: FloatArray) -> FloatArray:
    """Products (K, K) of rows (K, S, 2 W) [V] in sigmas of noise that is not white.

    Raises
    ------
    numpy.linalg.LinAlgError : the covariance of noise that depends on the signal is not positive definite.
    """
    depends = noise.dependent.size > 0
    flat = generalised_rows(rows, item, noise) if depends else stationary_rows(rows, item, variance)
    return np.asarray(flat @ flat.T)


def stationary_rows(rows: FloatArray, item: BandData, variance: FloatArray) -> FloatArray:
    """Rows (K, 2 S W) of rows (K, S, 2 W) [V] in units of noise of ``variance`` (S, W) [V^2]."""
    weighted = rows * np.tile(record_weight(item, variance), 2)
    return np.asarray(weighted.reshape(rows.shape[0], -1))


def generalised_rows(spectra: FloatArray, item: BandData, noise: BandNoise) -> FloatArray:
    """Rows (K, 2 r) of rows (K, S, 2 W) [V] in sigmas of noise that depends on time.

    Raises
    ------
    numpy.linalg.LinAlgError : the covariance of the noise is not positive definite.
    """
    scale = math.sqrt(2.0 / item.band.samples)
    parts, bases = [], []
    for channel in (0, 1):
        own = spectra[:, channel].T * scale
        unit = own / np.maximum(np.linalg.norm(own, axis=0), 1e-300)
        # Without pivots a column that depends on others takes a direction that later ones need: p-values moved by a half.
        basis, triangle, _ = qr(unit, mode="economic", pivoting=True, check_finite=False)
        seen = np.abs(np.diag(triangle)) > _ROUNDING
        bases.append(basis[:, seen])
        parts.append(basis[:, seen].T @ own)
    first = slice(0, bases[0].shape[1])
    second = slice(first.stop, None)
    pairs = covariance(np.concatenate(bases, axis=1), item.band, noise)
    crossed = pairs[1][first, second]
    whole = np.block([[pairs[0][first, first], crossed], [crossed.T, pairs[2][second, second]]])
    factor = cholesky(whole, lower=True)
    return np.asarray(solve_triangular(factor, np.concatenate(parts), lower=True).T)
