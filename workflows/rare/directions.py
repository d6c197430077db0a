"""In which directions of the latent normals a limit is exceeded.

    G_i = (g(z_i + h e_j) - g(z_i)) / h   (d,)   at lost devices z_i
    C = mean of G_i G_i^T / |G_i|^2

A latent normal with a large part of C is a direction of its own, and C is formed again without it, because the slope along a jump
(a die, a leak) would hide all others.  The leading eigenvectors of what remains are directions: sums of many small influences,
which lost devices alone would show only if there were many.  Latent normals are added whose lost devices differ from the
population across these directions.

Shapes: m devices, d latent normals, a fitted directions.
Source: Uribe, Papaioannou, Marzouk, Straub, SIAM/ASA J. Uncertainty Quantification 9 (2021) 818 (failure-informed dimension
reduction); Constantine, Active Subspaces (2015).
"""

from __future__ import annotations

import math

import numpy as np

from pipeline.arrays import FloatArray

from .subset import Response

#: Step of the differences [sd]: the number of a die changes in steps.
_STEP = 0.5
#: A mean or variance differs from that of the population beyond this many of its standard errors.
_SIGNIFICANT = 3.0
#: A latent normal with this share of C is a direction of its own, at most so many.
_LARGE, _OWN = 0.3, 6
#: Eigenvectors are taken until they explain this share of the remaining C, at most so many.
_EXPLAINED, _MOST = 0.99, 8


def gradients(response: Response, z: FloatArray) -> FloatArray:
    """G (m, d) at z (m, d), from m (d + 1) devices; devices with a response that is not finite are left out."""
    m, dimension = z.shape
    moved = z[:, None, :] + _STEP * np.eye(dimension)
    g = response(np.concatenate([z, moved.reshape(-1, dimension)]))
    found = (g[m:].reshape(m, dimension) - g[:m, None]) / _STEP
    return np.asarray(found[np.all(np.isfinite(found), axis=1)])


def slope_directions(slopes: FloatArray) -> FloatArray:
    """Orthonormal columns (d, a) from slopes (m, d); none without slopes."""
    dimension = slopes.shape[1]
    own = np.zeros(dimension, dtype=np.bool_)
    while True:
        rows = np.where(own, 0.0, slopes)
        size = np.sqrt(np.sum(rows**2, axis=1))
        rows = rows[size > 0.0] / size[size > 0.0, None]
        if not len(rows):
            return np.eye(dimension)[:, own]
        large = np.mean(rows**2, axis=0) > _LARGE
        if not np.any(large) or np.sum(own | large) > _OWN:
            break
        own |= large
    values, vectors = np.linalg.eigh(rows.T @ rows / len(rows))
    share = np.cumsum(values[::-1]) / np.sum(values)
    count = min(int(np.searchsorted(share, _EXPLAINED)) + 1, _MOST)
    return np.concatenate([np.eye(dimension)[:, own], vectors[:, ::-1][:, :count]], axis=1)


def fitted_directions(z: FloatArray, weight: FloatArray, independent: float, slopes: FloatArray) -> FloatArray:
    """Orthonormal columns (d, a): those of the slopes, and latent normals that differ among lost devices across them.

    Parameters
    ----------
    z, weight : lost devices (n, d) and their weights (n,), which add up to one.
    independent : number of independent devices that they are worth.
    slopes : of :func:`gradients`.
    """
    basis = slope_directions(slopes)
    across = z - (z @ basis) @ basis.T
    free = np.maximum(1.0 - np.sum(basis**2, axis=1), 0.0)
    mean = weight @ across
    variance = weight @ (across - mean) ** 2
    error = _SIGNIFICANT / math.sqrt(independent)
    different = (np.abs(mean) > error * np.sqrt(free)) | (variance > free * (1.0 + math.sqrt(2.0) * error))
    different &= free > 0.5
    if not basis.shape[1]:
        # A search always has a direction: at least the largest mean.
        different[np.argmax(np.abs(mean))] = True
    added = np.concatenate([basis, np.eye(z.shape[1])[:, different]], axis=1)
    return np.asarray(np.linalg.qr(added)[0])
