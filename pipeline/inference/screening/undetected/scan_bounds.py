"""Scores and bounds of scanned effects: each point of a scan has four columns (``scanned``).

    Z~' Z~ = Z' Z - O' O,   Z~' r = Z' r - O' (Q' r),   O = Q' Z         for all points at once

Shapes: g points, P parameters, Q quantities.
"""

from __future__ import annotations

import numpy as np
from scipy.special import fdtrc

from ....arrays import FloatArray
from .bounds import Z95, Judged, Projection
from .scanned import ScannedProducts

#: Share of the range of a scan for which a bound holds.
_SHARE = 0.95
#: Share of the energy of a column below which it counts as absorbed by the fit.
_RIDGE = 1e-9


def judged_scans(products: ScannedProducts, slopes: FloatArray, prior: FloatArray, noise_dof: float) -> Judged:
    """p-values and bounds of the scans.

    Parameters
    ----------
    products : summed over the records.
    slopes : dq/dx (Q, P).
    prior : rows of the prior, [J, r]' [J, r] (P + 1, P + 1).
    noise_dof : degrees of freedom of the noise level.

    Raises
    ------
    numpy.linalg.LinAlgError : the Jacobian has no full rank.
    """
    count, scans = slopes.shape[1], products.scans
    base = products.base + prior
    projection = Projection.of(base[:count, :count], slopes)
    residual = projection.overlap(base[:count, count:])[:, 0]
    if not scans:
        return Judged((), np.zeros(0), np.zeros(0), np.zeros((0, slopes.shape[0])))
    cross, raw = np.concatenate(products.cross), np.concatenate(products.gram)
    points = raw.shape[0]
    size = np.sqrt(np.diagonal(raw, axis1=1, axis2=2))
    cross = cross / size[:, None, :]
    overlap = projection.overlap(cross[:, :count].transpose(1, 0, 2).reshape(count, -1))
    by_point = np.ascontiguousarray(overlap.reshape(count, points, 4).transpose(1, 0, 2))
    gram = raw / (size[:, :, None] * size[:, None, :]) - np.swapaxes(by_point, 1, 2) @ by_point
    inverse = np.linalg.inv(gram + _RIDGE * np.eye(4))
    score = cross[:, count] - residual @ by_point
    estimate = (inverse @ score[:, :, None])[:, :, 0]
    every = np.sum(estimate * score, axis=1)
    bias = np.swapaxes(projection.bias(overlap).reshape(-1, points, 4), 0, 1)
    variance = np.sum((bias @ inverse) * bias, axis=2)
    each = np.abs(bias @ estimate[:, :, None])[:, :, 0] + Z95 * np.sqrt(np.maximum(variance, 0.0))
    reach = np.repeat([scan.reach for scan in scans], [len(one) for one in products.gram])
    each = np.minimum(each, np.sum(np.abs(bias) * (reach[:, None] * size)[:, None], axis=2)).T
    p_values, explained, bounds = np.ones(len(scans)), np.zeros(len(scans)), np.zeros((len(scans), slopes.shape[0]))
    last = 0
    for i, scan in enumerate(scans):
        first, last = last, last + products.gram[i].shape[0]
        explained[i] = float(np.max(every[first:last]))
        single = float(fdtrc(4.0, noise_dof, explained[i] / 4.0))
        p_values[i] = -np.expm1((last - first) * np.log1p(-min(single, 1.0 - 1e-16)))
        bounds[i] = _quantile(each[:, first:last], scan.weight)
    return Judged(tuple(scan.effect for scan in scans), p_values, explained, bounds)


def _quantile(values: FloatArray, weight: FloatArray) -> FloatArray:
    """Weighted quantile (Q,) of values (Q, g) at ``_SHARE``; the largest without weights."""
    if not weight.size:
        return np.asarray(values.max(axis=1))
    order = np.argsort(values, axis=1)
    below = np.cumsum(weight[order], axis=1)
    place = np.argmax(below >= _SHARE, axis=1)
    return np.take_along_axis(values, np.take_along_axis(order, place[:, None], axis=1), axis=1)[:, 0]
