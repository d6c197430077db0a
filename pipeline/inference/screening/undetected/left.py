"""What a fit leaves of the signatures of effects, and scores and bounds from it (``bounds``), in compiled loops.

    s = |z|,   O = R'^-1 J' Z / s,   Z~' r = Z' r / s - O' (Q' r),   Z~' Z~ = Z' Z / (s s') - O' O = V L V',   bias = dq/dx R^-1 O

Shapes: B devices, P parameters, K columns Z, Q quantities, E effects of up to k columns.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit

from ....arrays import FloatArray, IntArray

#: [J, r, Z]' [J, r, Z] (P + 1 + K, P + 1 + K), R'^-1 (P, P), and dq/dx R^-1 (Q, P) of a device.
Products = tuple[FloatArray, FloatArray, FloatArray]


#: Share of a signature's energy below which its direction counts as absorbed by the fit: the square of what rounding leaves.
_ABSORBED = 1e-10


@dataclass(frozen=True, eq=False)
class EffectColumns:
    """The names of effects, their ``columns`` (E, k), and how many each has, ``count`` (E,): those beyond are not used."""

    effects: tuple[str, ...]
    columns: IntArray
    count: IntArray

    @property
    def several(self) -> IntArray:
        """Numbers of the effects with more than one column."""
        return np.flatnonzero(self.count > 1)


@dataclass(frozen=True, eq=False)
class Left:
    """What is left of unit columns.

    Parameters
    ----------
    scale : (B, K) norms of the columns.
    score, size : (B, K) Z~' r, and |z~|^2.
    bias : (B, Q, K) of the quantities.
    blocks : (B, E, k, k) Z~' Z~ within effects; zero where an effect has fewer columns.
    """

    scale: FloatArray
    score: FloatArray
    size: FloatArray
    bias: FloatArray
    blocks: FloatArray


def left_of(devices: Sequence[Products], effects: EffectColumns) -> Left:
    """What the fits of devices with equal shapes leave of the columns of ``effects``.

    Raises
    ------
    ValueError : the devices have different shapes.
    """
    products, whiten, slopes = devices[0]
    shapes = [tuple(each.shape for each in own) for own in devices]
    if any(shape != shapes[0] for shape in shapes):
        raise ValueError(f"devices with different shapes: {shapes}")
    count, columns = len(devices), products.shape[0] - whiten.shape[0] - 1
    scale, score, size = (np.empty((count, columns)) for _ in range(3))
    bias = np.empty((count, slopes.shape[0], columns))
    blocks = np.zeros((count, *effects.columns.shape, effects.columns.shape[1]))
    for b, own in enumerate(devices):
        _write_left(*own, effects.columns, effects.count, scale[b], score[b], size[b], bias[b], blocks[b])
    return Left(scale, score, size, bias, blocks)


@njit(cache=True, error_model="numpy", fastmath={"contract", "nsz"})
def _write_left(
    products: FloatArray,
    whiten: FloatArray,
    slopes: FloatArray,
    own_columns: IntArray,
    own_count: IntArray,
    scale: FloatArray,
    score: FloatArray,
    size: FloatArray,
    bias: FloatArray,
    blocks: FloatArray,
) -> None:
    """Write the elements of :class:`Left` of one device."""
    count, columns = whiten.shape[0], score.size
    first = count + 1
    residual, overlap = np.zeros(count), np.zeros((count, columns))
    for k in range(columns):
        square = products[first + k, first + k]
        scale[k] = math.sqrt(max(square, 1e-300))
        # A column of zeros has the size 0, not 1.
        size[k], score[k] = square / (scale[k] * scale[k]), products[count, first + k] / scale[k]
    for p in range(count):
        for m in range(count):
            own = whiten[p, m]
            residual[p] += own * products[m, count]
            for k in range(columns):
                overlap[p, k] += own * products[m, first + k]
        for k in range(columns):
            overlap[p, k] /= scale[k]
            size[k] -= overlap[p, k] * overlap[p, k]
            score[k] -= overlap[p, k] * residual[p]
    bias[:] = 0.0
    for q in range(slopes.shape[0]):
        for p in range(count):
            for k in range(columns):
                bias[q, k] += slopes[q, p] * overlap[p, k]
    for e in range(own_count.size):
        for i in range(own_count[e]):
            for j in range(i + 1):
                k, l = own_columns[e, i], own_columns[e, j]
                total = products[first + k, first + l] / (scale[k] * scale[l])
                for p in range(count):
                    total -= overlap[p, k] * overlap[p, l]
                blocks[e, i, j] = blocks[e, j, i] = total


@dataclass(frozen=True, eq=False)
class Scored:
    """Effects of devices.

    Parameters
    ----------
    seen : (B, E) directions that the fit does not absorb.
    share : (B, E) part of the probability beyond T that counts: a half for one sign; 0: no evidence.
    explained, bounds : T (B, E), and bounds (B, E, Q).
    """

    seen: FloatArray
    share: FloatArray
    explained: FloatArray
    bounds: FloatArray


def scores_of(left: Left, effects: EffectColumns, low: FloatArray, high: FloatArray, z: float) -> Scored:
    """Scores and bounds, ``z`` sigmas wide, of effects whose columns have strengths between ``low`` and ``high`` (B, K)."""
    shape = left.blocks.shape[:2]
    size, vector = left.blocks.diagonal(axis1=2, axis2=3).copy(), np.zeros(left.blocks.shape)
    vector[:, :, 0, 0] = 1.0
    if effects.several.size:
        size[:, effects.several], vector[:, effects.several] = np.linalg.eigh(left.blocks[:, effects.several])
    seen, share, explained = (np.empty(shape) for _ in range(3))
    bounds = np.empty((*shape, left.bias.shape[1]))
    for b in range(shape[0]):
        _score(
            left.score[b],
            left.bias[b],
            size[b],
            vector[b],
            effects.columns,
            effects.count,
            low[b],
            high[b],
            z,
            seen[b],
            share[b],
            explained[b],
            bounds[b],
        )
    return Scored(seen, share, explained, bounds)


@njit(cache=True, error_model="numpy")
def _score(
    score: FloatArray,
    bias: FloatArray,
    size: FloatArray,
    vector: FloatArray,
    columns: IntArray,
    count: IntArray,
    low: FloatArray,
    high: FloatArray,
    z: float,
    seen: FloatArray,
    share: FloatArray,
    explained: FloatArray,
    bounds: FloatArray,
) -> None:
    """Write :class:`Scored` of one device, from eigenvalues (E, k) and eigenvectors (E, k, k) of Z~' Z~."""
    strength, visible = np.empty(columns.shape[1]), np.empty(columns.shape[1])
    for e in range(count.size):
        own, most = columns[e, : count[e]], columns.shape[1]
        side = 0.0
        if own.size == 1:
            side = 1.0 if low[own[0]] == 0.0 else -1.0 if high[own[0]] == 0.0 else 0.0
        # Strengths along the eigenvectors; none where the fit absorbs one.
        seen[e], share[e], explained[e] = 0.0, 1.0, 0.0
        for j in range(most):
            strength[j] = 0.0
            if size[e, j] > _ABSORBED:
                seen[e] += 1.0
                for i in range(own.size):
                    strength[j] += vector[e, i, j] * score[own[i]]
                explained[e] += strength[j] * strength[j] / size[e, j]
                strength[j] /= size[e, j]
        if side != 0.0:
            share[e] = 0.5 if side * score[own[0]] > 0.0 else 0.0
            strength[0] = side * max(side * strength[0], 0.0)
        if seen[e] == 0.0:
            share[e] = 0.0
        for q in range(bias.shape[0]):
            # No bias, no effect, however large.
            within = 0.0
            for i in range(own.size):
                if bias[q, own[i]] != 0.0:
                    within += abs(bias[q, own[i]]) * max(abs(low[own[i]]), abs(high[own[i]]))
            bounds[e, q] = within
            if seen[e] == 0.0:
                continue
            shift, square, hidden = 0.0, 0.0, 0.0
            for j in range(most):
                visible[j] = 0.0
                if size[e, j] > _ABSORBED:
                    for i in range(own.size):
                        visible[j] += bias[q, own[i]] * vector[e, i, j]
                    shift += visible[j] * strength[j]
                    square += visible[j] * visible[j] / size[e, j]
            if seen[e] < own.size:
                for i in range(own.size):
                    rest = bias[q, own[i]]
                    for j in range(most):
                        rest -= visible[j] * vector[e, i, j]
                    if rest != 0.0:
                        hidden += abs(rest) * max(abs(low[own[i]]), abs(high[own[i]]))
            bounds[e, q] = min(abs(shift) + z * math.sqrt(square) + hidden, within)
