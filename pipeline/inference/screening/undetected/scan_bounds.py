"""Scores and bounds of scanned effects: each point of a scan has four columns (``scanned``).

    Z~' Z~ = Z' Z - O' O = L L',   Z~' r = Z' r - O' (Q' r),   O = Q' Z
    T = |L^-1 Z~' r|^2,   bound = |b' a| + z |L^-1 b|,   a = (L L')^-1 Z~' r

Shapes: g points, P parameters, Q quantities.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from scipy.special import fdtrc

from ....arrays import FloatArray
from .bounds import Z95, Judged, Projection
from .scanned import ScannedProducts

#: Share of the range of a scan for which a bound holds.
_SHARE = 0.95
#: Share of the energy of a column below which it counts as absorbed by the fit, and the least that rounding leaves of a square.
_RIDGE, _LEAST = 1e-9, 1e-12


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
    overlap = projection.overlap(products.cross[:count].reshape(count, -1))
    bias = projection.bias(overlap)
    reach = np.concatenate([np.full(scan.points, scan.reach) for scan in scans])
    every, each = np.empty(points), np.empty((q, points))
    left = products.cross[count].reshape(-1) - projection.overlap(residual) @ overlap
    shape = (2, points, 2)
    _judge_points(
        products.squares,
        overlap.reshape(count, *shape),
        left.reshape(shape),
        bias.reshape(q, *shape),
        reach,
        every,
        each,
    )
    p_values, explained, bounds = np.ones(len(scans)), np.zeros(len(scans)), np.zeros((len(scans), q))
    last = 0
    for i, scan in enumerate(scans):
        first, last = last, last + scan.points
        explained[i] = float(np.max(every[first:last]))
        single = float(fdtrc(4.0, noise_dof, explained[i] / 4.0))
        p_values[i] = -math.expm1(scan.points * math.log1p(-min(single, 1.0 - 1e-16)))
        bounds[i] = _quantile(each[:, first:last], scan.weight)
    return Judged(tuple(scan.effect for scan in scans), p_values, explained, bounds)


@njit(cache=True, error_model="numpy")
def _judge_points(
    squares: FloatArray,
    overlap: FloatArray,
    score: FloatArray,
    bias: FloatArray,
    reach: FloatArray,
    explained: FloatArray,
    bounds: FloatArray,
) -> None:
    """Write T (g,) and the bounds (Q, g) of points, each with the columns (a, i) = 11, 12, 21, 22 of both channels a.

    A column that is zero, as the drive does not reach it, has the norm 1: it stays zero, and nothing is seen of its effect.

    Parameters
    ----------
    squares : Z' Z (S, g, 3).
    overlap, score, bias : Q' Z (P, S, g, 2), Z~' r (S, g, 2), and the biases (Q, S, g, 2) by columns of unit strength.
    reach : largest strengths (g,).
    """
    size, z, solved = np.empty(4), np.empty(4), np.empty(4)
    gram = np.empty((4, 4))
    for g in range(reach.size):
        for k in range(4):
            own = math.sqrt(squares[k // 2, g, 2 * (k % 2)])
            size[k] = own if own > 0.0 else 1.0
        for k in range(4):
            for l in range(k + 1):
                total = 1.0 + _RIDGE if k == l else 0.0
                if k != l and k // 2 == l // 2:
                    total = squares[k // 2, g, 1] / (size[k] * size[l])
                shared = 0.0
                for p in range(overlap.shape[0]):
                    shared += overlap[p, k // 2, g, k % 2] * overlap[p, l // 2, g, l % 2]
                gram[k, l] = total - shared / (size[k] * size[l])
        # Cholesky factor, in place of the lower triangle.
        for k in range(4):
            for l in range(k + 1):
                total = gram[k, l]
                for m in range(l):
                    total -= gram[k, m] * gram[l, m]
                # Rounding takes no more than the ridge.
                gram[k, l] = math.sqrt(max(total, _LEAST)) if k == l else total / gram[l, l]
        explained[g] = 0.0
        for k in range(4):
            z[k] = score[k // 2, g, k % 2] / size[k]
            for m in range(k):
                z[k] -= gram[k, m] * z[m]
            z[k] /= gram[k, k]
            explained[g] += z[k] * z[k]
        for i in range(bias.shape[0]):
            square, shift, most = 0.0, 0.0, 0.0
            for k in range(4):
                own = bias[i, k // 2, g, k % 2] / size[k]
                if own != 0.0:
                    most += abs(own) * size[k] * reach[g]
                for m in range(k):
                    own -= gram[k, m] * solved[m]
                solved[k] = own / gram[k, k]
                square += solved[k] * solved[k]
                shift += solved[k] * z[k]
            # Lines have no largest strength, and a quantity may have no bias at all: the quadrature bias without a phase error.
            bounds[i, g] = min(abs(shift) + Z95 * math.sqrt(square), most)


def _quantile(values: FloatArray, weight: FloatArray) -> FloatArray:
    """Weighted quantile (Q,) of values (Q, g) at ``_SHARE``; the largest without weights."""
    if not weight.size:
        return np.asarray(values.max(axis=1))
    out = np.empty(values.shape[0])
    _least_above(values, weight, (1.0 - _SHARE) * float(weight.sum()), out)
    return out


@njit(cache=True)
def _least_above(values: FloatArray, weight: FloatArray, share: float, out: FloatArray) -> None:
    """Write the least of the largest values (Q,) of values (Q, g) that have more than the weight ``share`` together.

    The largest are taken one by one: they are few.  It is nan where values are.
    """
    for i in range(values.shape[0]):
        taken = np.zeros(weight.size, dtype=np.bool_)
        above, out[i] = 0.0, np.nan
        while above <= share:
            largest = -1
            for g in range(weight.size):
                if not taken[g] and (largest < 0 or values[i, g] > values[i, largest]):
                    largest = g
            if largest < 0:
                break
            taken[largest] = True
            above += weight[largest]
            out[i] = values[i, largest]
