"""The baseline projected out of residual and signatures, once.

    Q R = J,   Z~ = (1 - Q Q') Z,   s = Z~' r~,   G = Z~' Z~,   S = Z~' Gamma Z~

s is the score; its covariance is G for white noise of unit variance, S where the noise of stratum g is gamma_g times stronger:

    gamma_g = max(1, sum of r^2 over the stratum / its degrees of freedom)

A misfit in few of many rows hardly moves gamma, and never downwards: a wrong noise level makes no evidence.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from .problem import FitResult

_RANK = 1e-11
#: Rows at a time: what is made of them stays in the processor's cache.
_CHUNK = 2048


@dataclass(frozen=True, eq=False)
class Baseline:
    """Orthonormal columns of the jacobian, block by block.

    ``basis`` (n m, p) a block; ``upper`` (p, P) with J = basis upper; ``residual`` (n m,) a block, projected;
    ``gamma`` (n m,) a block; ``dof`` of what is left.
    """

    basis: tuple[FloatArray, ...]
    upper: FloatArray
    residual: tuple[FloatArray, ...]
    gamma: tuple[FloatArray, ...]
    dof: int


@dataclass(frozen=True, eq=False)
class Projected:
    """Scores (K,), their nominal and actual covariance G and S (K, K), all for columns of Z scaled to unit norm.

    ``norms`` (K,) are those of Z before the scaling and the projection, so diag(G) is the square of the surviving share;
    ``chi2`` and ``dof`` are those of the projected residual.
    """

    score: FloatArray
    gram: FloatArray
    covariance: FloatArray
    norms: FloatArray
    chi2: float
    dof: int


def baseline(fit: FitResult, without: Sequence[int] = ()) -> Baseline:
    """Orthonormalise the jacobian of a fit, leaving out the columns ``without``.

    Two passes (the second takes out what rounding left of the first), so that a signature of which one part in a
    million survives is still right.
    """
    keep = [column for column in range(fit.jacobian[0].shape[1]) if column not in set(without)]
    blocks = tuple(block[:, keep] for block in fit.jacobian)
    first = _orthonormal(blocks)
    second = _orthonormal(first[0])
    basis, upper = second[0], second[1] @ first[1]
    raw = tuple(block.rows for block in fit.blocks)
    residual = _reject(basis, raw)
    dof = fit.rows - upper.shape[0] - fit.nuisances
    return Baseline(basis, upper, residual, _gamma(fit, residual, dof), dof)


def project(base: Baseline, columns: Sequence[FloatArray]) -> Projected:
    """Scores of some columns (for each block (n m, K)) after the baseline."""
    count = columns[0].shape[1]
    overlap = sum((q.T @ z for q, z in zip(base.basis, columns)), np.zeros((base.upper.shape[0], count)))
    score, gram, covariance = np.zeros(count), np.zeros((count, count)), np.zeros((count, count))
    for q, z, r, gamma in zip(base.basis, columns, base.residual, base.gamma):
        for first in range(0, z.shape[0], _CHUNK):
            rows = slice(first, first + _CHUNK)
            rest, noise = z[rows] - q[rows] @ overlap, gamma[rows]
            score += rest.T @ r[rows]
            for level in np.unique(noise):
                part = rest[noise == level]
                own = part.T @ part
                gram += own
                covariance += level * own
    norms = np.sqrt(np.diagonal(gram) + np.sum(overlap**2, axis=0))
    inverse = np.divide(1.0, norms, out=np.zeros(count), where=norms > 0.0)
    unit = np.outer(inverse, inverse)
    chi2 = sum(float(np.vdot(r, r)) for r in base.residual)
    return Projected(score * inverse, gram * unit, covariance * unit, norms, chi2, base.dof)


def _orthonormal(blocks: Sequence[FloatArray]) -> tuple[tuple[FloatArray, ...], FloatArray]:
    """Q by blocks and the factor T (p, P) with J = Q T; directions below the rank tolerance are dropped."""
    if blocks[0].shape[1] == 0:
        return tuple(blocks), np.zeros((0, 0))
    stacked = np.concatenate([_triangle(block) for block in blocks])
    upper = _triangle(stacked)
    scale = np.linalg.norm(upper, axis=0)
    scale[scale == 0.0] = 1.0
    _, size, vt = np.linalg.svd(upper / scale)
    rank = int(np.sum(size > _RANK * size.max(initial=0.0))) if size.size else 0
    factor = size[:rank, None] * vt[:rank]
    inverse = vt[:rank].T / size[:rank] / scale[:, None]
    return tuple(block @ inverse for block in blocks), factor * scale


def _triangle(matrix: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.qr(matrix, mode="r"))


def _reject(basis: Sequence[FloatArray], rows: Sequence[FloatArray]) -> tuple[FloatArray, ...]:
    overlap = sum((q.T @ r for q, r in zip(basis, rows)), np.zeros(basis[0].shape[1]))
    return tuple(r - q @ overlap for q, r in zip(basis, rows))


def _gamma(fit: FitResult, residual: Sequence[FloatArray], dof: int) -> tuple[FloatArray, ...]:
    if fit.strata is None or not fit.noise_known:
        return tuple(np.ones(r.size) for r in residual)
    strata = np.concatenate(fit.strata)
    counts = np.bincount(strata)
    energy = np.bincount(strata, weights=np.concatenate(residual) ** 2)
    # The fitted parameters' degrees of freedom are spread over the strata in proportion to their rows.
    expected = np.maximum(counts * (dof / strata.size), 1e-300)
    level = np.maximum(1.0, energy / expected)
    return tuple(level[part] for part in fit.strata)
