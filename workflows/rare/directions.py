"""In which directions of the latent normals a limit is exceeded.

    G_i = (g(z_i + h e_j) - g(z_i)) / h   (d,)   at lost devices z_i
    C = mean of G_i G_i^T / |G_i|^2             leading eigenvectors: the directions

Beside the latent normals that the lost devices show to be shifted or spread (``active``), the fit of the proposal needs the sum
of many small influences, which too few devices cannot show; differences of the response can.

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
#: Directions are taken until they explain this share of C, at most so many.
_EXPLAINED, _MOST = 0.99, 8


def gradients(response: Response, z: FloatArray) -> FloatArray:
    """G (m, d) at z (m, d), from m (d + 1) devices; devices with a response that is not finite are left out."""
    m, dimension = z.shape
    moved = z[:, None, :] + _STEP * np.eye(dimension)
    g = response(np.concatenate([z, moved.reshape(-1, dimension)]))
    found = (g[m:].reshape(m, dimension) - g[:m, None]) / _STEP
    return np.asarray(found[np.all(np.isfinite(found), axis=1)])


def fitted_directions(z: FloatArray, weight: FloatArray, independent: float, slopes: FloatArray) -> FloatArray:
    """Orthonormal columns (d, a): the latent normals that differ among lost devices, then directions of the others.

    Parameters
    ----------
    z, weight : lost devices (n, d) and their weights (n,), which add up to one.
    independent : number of independent devices that they are worth.
    slopes : of :func:`gradients`.
    """
    mean = weight @ z
    variance = weight @ (z - mean) ** 2
    error = 1.0 / math.sqrt(independent)
    active = (np.abs(mean) > _SIGNIFICANT * error) | (variance > 1.0 + _SIGNIFICANT * math.sqrt(2.0) * error)
    # A search always has a direction: at least the largest mean.
    active[np.argmax(np.abs(mean))] = True
    basis = np.eye(z.shape[1])[:, active]
    # Of the others: a jump along an active one would hide their slopes.
    others = np.where(active, 0.0, slopes)
    size = np.sqrt(np.sum(others**2, axis=1))
    rows = others[size > 0.0] / size[size > 0.0, None]
    if not len(rows):
        return basis
    values, vectors = np.linalg.eigh(rows.T @ rows / len(rows))
    share = np.cumsum(values[::-1]) / np.sum(values)
    count = min(int(np.searchsorted(share, _EXPLAINED)) + 1, _MOST)
    return np.concatenate([basis, vectors[:, ::-1][:, :count]], axis=1)
