"""Scores and bounds of scanned effects: each point of a scan has four columns (``scanned``).

    Z~' Z~ = Z' Z - O' O = L L',   Z~' r = Z' r - O' (Q' r),   O = Q' Z
    T = |L^-1 Z~' r|^2,   bound = |b' a| + z |L^-1 b|,   a = (L L')^-1 Z~' r

Shapes: g points, P parameters, Q quantities.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numba import njit
from scipy.special import fdtrc

from ....arrays import FloatArray, IntArray
from .bounds import Z95, Judged, Projection
from .scanned import ScannedProducts, ScanPoints

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
    q = projection.slopes.shape[0]
    if not products.scans:
        return Judged((), np.zeros(0), np.zeros(0), np.zeros((0, q)))
    whole, count = _whole(products.scans), residual.size
    # Loops over points need them next to each other.
    cross = np.ascontiguousarray(products.cross.swapaxes(2, 3)).reshape(count + 1, -1)
    overlap = projection.overlap(cross[:count])
    g = whole.reach.size
    shape = (4, g)
    score = cross[count] - projection.overlap(residual) @ overlap
    every, each, bounds = np.empty(g), np.empty((q, g)), np.empty((whole.points.size, q))
    _judge_points(
        np.ascontiguousarray(products.squares.swapaxes(1, 2)),
        overlap.reshape(count, *shape),
        score.reshape(shape),
        projection.bias(overlap).reshape(q, *shape),
        whole.reach,
        every,
        each,
    )
    explained = np.maximum.reduceat(every, whole.first)
    _least_above(each, whole.first, whole.weight, whole.above, bounds)
    p_values = []
    for total, points in zip(explained.tolist(), whole.points.tolist()):
        single = float(fdtrc(4.0, noise_dof, total / 4.0))
        p_values.append(-math.expm1(points * math.log1p(-min(single, 1.0 - 1e-16))))
    return Judged(tuple(scan.effect for scan in products.scans), np.array(p_values), explained, bounds)


@dataclass(frozen=True, eq=False)
class _Whole:
    """The points of all scans, one scan after the other.

    Parameters
    ----------
    points, first : their number in each scan (n,), and its first point.
    reach, weight : largest strength and weight of each point (g,).
    above : (n,) weight of the largest values of a scan beyond which its bound lies.
    """

    points: IntArray
    first: IntArray
    reach: FloatArray
    weight: FloatArray
    above: FloatArray


@lru_cache(maxsize=4)
def _whole(scans: tuple[ScanPoints, ...]) -> _Whole:
    # Without weights a single point has more than nothing: the bound is the largest value.
    points = np.array([scan.points for scan in scans])
    return _Whole(
        points,
        np.cumsum(points) - points,
        np.concatenate([np.full(scan.points, scan.reach) for scan in scans]),
        np.concatenate([scan.weight if scan.weight.size else np.ones(scan.points) for scan in scans]),
        np.array([(1.0 - _SHARE) * float(scan.weight.sum()) for scan in scans]),
    )


@njit(cache=True, error_model="numpy", fastmath={"contract", "nsz"})
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
    squares : Z' Z (S, 3, g).
    overlap, score, bias : Q' Z (P, 4, g), Z~' r (4, g), and the biases (Q, 4, g) by columns of unit strength.
    reach : largest strengths (g,).
    """
    points = reach.size
    per_unit, z, solved = np.empty((4, points)), np.empty((4, points)), np.empty((4, points))
    gram, total, square = np.empty((4, 4, points)), np.empty(points), np.empty(points)
    # All inner loops run over the points: one point after the other takes three times as long.
    for k in range(4):
        for g in range(points):
            own = squares[k // 2, 2 * (k % 2), g]
            per_unit[k, g] = 1.0 / math.sqrt(own) if own > 0.0 else 1.0
    for k in range(4):
        for l in range(k + 1):
            # Not total[:] = an array: numba would compile the text of an error with it, 2 s.
            for g in range(points):
                total[g] = squares[k // 2, 1, g] if k != l and k // 2 == l // 2 else 0.0
            for p in range(overlap.shape[0]):
                for g in range(points):
                    total[g] -= overlap[p, k, g] * overlap[p, l, g]
            ridge = 1.0 + _RIDGE if k == l else 0.0
            for g in range(points):
                gram[k, l, g] = ridge + total[g] * (per_unit[k, g] * per_unit[l, g])
    # Cholesky factor, in place of the lower triangle, with inverse elements on the diagonal.
    for k in range(4):
        for l in range(k + 1):
            for g in range(points):
                total[g] = gram[k, l, g]
            for m in range(l):
                for g in range(points):
                    total[g] -= gram[k, m, g] * gram[l, m, g]
            if k == l:
                # Rounding takes no more than the ridge.
                for g in range(points):
                    gram[k, k, g] = 1.0 / math.sqrt(max(total[g], _LEAST))
            else:
                for g in range(points):
                    gram[k, l, g] = total[g] * gram[l, l, g]
    explained[:] = 0.0
    for k in range(4):
        _solve_next(score, per_unit, gram, k, z)
        for g in range(points):
            explained[g] += z[k, g] * z[k, g]
    for i in range(bias.shape[0]):
        square[:], total[:], bounds[i] = 0.0, 0.0, 0.0
        for k in range(4):
            _solve_next(bias[i], per_unit, gram, k, solved)
            for g in range(points):
                square[g] += solved[k, g] * solved[k, g]
                total[g] += solved[k, g] * z[k, g]
                own = abs(bias[i, k, g])
                # Lines have no largest strength, and the quadrature bias has no bias without a phase error.
                bounds[i, g] += own * reach[g] if own != 0.0 else 0.0
        for g in range(points):
            bounds[i, g] = min(abs(total[g]) + Z95 * math.sqrt(square[g]), bounds[i, g])


@njit(cache=True, error_model="numpy", fastmath={"contract", "nsz"})
def _solve_next(values: FloatArray, per_unit: FloatArray, factor: FloatArray, k: int, out: FloatArray) -> None:
    """Write element k of L^-1 v to ``out`` (4, g), of ``values`` (4, g) ``per_unit`` column; elements before it are known."""
    for g in range(out.shape[1]):
        out[k, g] = values[k, g] * per_unit[k, g]
    for m in range(k):
        for g in range(out.shape[1]):
            out[k, g] -= factor[k, m, g] * out[m, g]
    for g in range(out.shape[1]):
        out[k, g] *= factor[k, k, g]


@njit(cache=True, error_model="numpy")
def _least_above(values: FloatArray, first: IntArray, weight: FloatArray, above: FloatArray, out: FloatArray) -> None:
    """Write the least of the largest values (n, Q) of each scan that have more than the weight ``above`` (n,) together.

    It is nan where one of the values is.  The largest are kept in order while all are passed once: they are few.

    Parameters
    ----------
    values, weight : of all points (Q, g), (g,), one scan after the other.
    first : the first point of each scan (n,).
    """
    largest, own = np.empty(weight.size), np.empty(weight.size)
    for n in range(first.size):
        share, last = above[n], first[n + 1] if n + 1 < first.size else weight.size
        # The sum of a kept one and others is right to rounding only: those that the rounding may take are kept as well.
        enough = share + 1e-12 * abs(share)
        for i in range(values.shape[0]):
            kept, total, out[n, i] = 0, 0.0, np.nan
            for g in range(first[n], last):
                value = values[i, g]
                if np.isnan(value):
                    kept = 0
                    break
                if total > enough and value <= largest[kept - 1]:
                    continue
                at = kept
                while at > 0 and value > largest[at - 1]:
                    largest[at], own[at] = largest[at - 1], own[at - 1]
                    at -= 1
                largest[at], own[at] = value, weight[g]
                kept, total = kept + 1, total + weight[g]
                while total - own[kept - 1] > enough:
                    kept, total = kept - 1, total - own[kept - 1]
            sum_above = 0.0
            for k in range(kept):
                if sum_above > share:
                    break
                sum_above, out[n, i] = sum_above + own[k], largest[k]
