"""Scores and bounds of scanned effects: each point of a scan has four columns (``scanned``).

    Z~' Z~ = Z' Z - O' O,   Z~' r = Z' r - O' (Q' r),   O = Q' Z         for all points at once

Shapes: g points, P parameters, Q quantities.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.special import fdtrc

from ....arrays import FloatArray
from .bounds import Z95, Judged, Projection, at_most
from .scanned import ScannedProducts

#: Share of the range of a scan for which a bound holds.
_SHARE = 0.95
#: Share of the energy of a column below which it counts as absorbed by the fit.
_RIDGE = 1e-9


def judged_scans(products: ScannedProducts, projection: Projection, residual: FloatArray, noise_dof: float) -> Judged:
    """p-values and bounds of the scans.

    Parameters
    ----------
    products : summed over the records.
    projection : of the fit, with the rows of its prior.
    residual : J' r (P,), with those rows.
    noise_dof : degrees of freedom of the noise level.
    """
    scans, q = products.scans, projection.slopes.shape[0]
    if not scans:
        return Judged((), np.zeros(0), np.zeros(0), np.zeros((0, q)))
    count, points = residual.size, products.squares.shape[1]
    size, unit = _unit_columns(products.squares)
    cross = products.cross / size
    overlap = projection.overlap(cross[:count].reshape(count, -1))
    by_point = np.ascontiguousarray(overlap.reshape(count, 2, points, 2).transpose(2, 0, 1, 3)).reshape(
        points, count, 4
    )
    gram = unit - np.swapaxes(by_point, 1, 2) @ by_point
    inverse = np.linalg.inv(gram)
    score = cross[count].transpose(1, 0, 2).reshape(points, 4) - projection.overlap(residual) @ by_point
    estimate = (inverse @ score[:, :, None])[:, :, 0]
    every = np.einsum("gk,gk->g", estimate, score)
    bias = projection.slopes @ by_point
    spread = np.sqrt(np.maximum(np.einsum("gqk,gqk->gq", bias @ inverse, bias), 0.0))
    each = np.abs((bias @ estimate[:, :, None])[:, :, 0]) + Z95 * spread
    reach = np.concatenate([np.full(scan.points, scan.reach) for scan in scans])
    most = size.transpose(1, 0, 2).reshape(points, 4) * reach[:, None]
    # Lines have no largest strength, and a quantity may have no bias at all: the quadrature bias without a phase error.
    each = np.minimum(each, at_most(bias, most)).T
    p_values, explained, bounds = np.ones(len(scans)), np.zeros(len(scans)), np.zeros((len(scans), q))
    last = 0
    for i, scan in enumerate(scans):
        first, last = last, last + scan.points
        explained[i] = float(np.max(every[first:last]))
        single = float(fdtrc(4.0, noise_dof, explained[i] / 4.0))
        p_values[i] = -math.expm1(scan.points * math.log1p(-min(single, 1.0 - 1e-16)))
        bounds[i] = _quantile(each[:, first:last], scan.weight)
    return Judged(tuple(scan.effect for scan in scans), p_values, explained, bounds)


def _unit_columns(squares: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Norms (S, g, 2) of columns with products (S, g, 3), and the products (g, 4, 4) of the unit columns, with a ridge.

    A column that is zero, as the drive does not reach it, has the norm 1: it stays zero, and nothing is seen of its effect.
    """
    size = np.sqrt(squares[:, :, ::2])
    size = np.where(size > 0.0, size, 1.0)
    cosine = squares[:, :, 1] / (size[:, :, 0] * size[:, :, 1])
    unit = np.zeros((squares.shape[1], 4, 4))
    unit[:, np.arange(4), np.arange(4)] = 1.0 + _RIDGE
    for a in (0, 2):
        unit[:, a, a + 1] = unit[:, a + 1, a] = cosine[a // 2]
    return size, unit


def _quantile(values: FloatArray, weight: FloatArray) -> FloatArray:
    """Weighted quantile (Q,) of values (Q, g) at ``_SHARE``; the largest without weights."""
    if not weight.size:
        return np.asarray(values.max(axis=1))
    order = np.argsort(values, axis=1)
    below = np.cumsum(weight[order], axis=1)
    place = np.argmax(below >= _SHARE, axis=1)
    return np.take_along_axis(values, np.take_along_axis(order, place[:, None], axis=1), axis=1)[:, 0]
