"""The baseline projected out of residual and signatures, once.

    Q R = J,   Z~ = (1 - Q Q') Z,   s = Z~' r~,   G = Z~' Z~,   S = Z~' Gamma Z~

s is the score; its covariance is G for white noise of unit variance, S where the noise of stratum g is gamma_g times stronger:

    gamma_g = max(1, sum of r^2 over the stratum / its degrees of freedom)

A misfit in few of many rows hardly moves gamma, and never downwards: a wrong noise level makes no evidence.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ..arrays import FloatArray, IntArray
from .problem import FitResult

_RANK = 1e-11


@dataclass(frozen=True, eq=False)
class Baseline:
    """Orthonormal columns of the jacobian, block by block.

    ``basis`` (n m, p) a block; ``upper`` (p, P) with J = basis upper; ``residual`` (n m,) a block, projected;
    ``gamma`` (n m,) a block; ``levels`` gamma by stratum, empty where there are none; ``dof`` of what is left.
    """

    basis: tuple[FloatArray, ...]
    upper: FloatArray
    residual: tuple[FloatArray, ...]
    gamma: tuple[FloatArray, ...]
    levels: FloatArray
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


@lru_cache(maxsize=2)
def baseline(fit: FitResult, without: tuple[int, ...] = ()) -> Baseline:
    """Orthonormalise the jacobian of a fit, leaving out the columns ``without``.

    Two passes (the second takes out what rounding left of the first), so that a signature of which one part in a
    million survives is still right.  The last two are kept: a look asks for one of them several times.
    """
    keep = [column for column in range(fit.jacobian[0].shape[1]) if column not in set(without)]
    blocks = tuple(block[:, keep] for block in fit.jacobian)
    first = _orthonormal(blocks)
    second = _orthonormal(first[0])
    basis, upper = second[0], second[1] @ first[1]
    raw = tuple(block.rows for block in fit.blocks)
    residual = _reject(basis, raw)
    dof = fit.rows - upper.shape[0] - fit.nuisances
    gamma, levels = _gamma(fit, residual, dof)
    return Baseline(basis, upper, residual, gamma, levels, dof)


def stratum_grams(columns: Sequence[FloatArray], strata: Sequence[IntArray]) -> FloatArray:
    """Z' Z of the rows of each stratum (strata, K, K); they do not depend on a fit, so they serve at every one."""
    count = 1 + max(int(part.max(initial=0)) for part in strata)
    grams = np.zeros((count, columns[0].shape[1], columns[0].shape[1]))
    for z, own in zip(columns, strata):
        for stratum in np.unique(own):
            part = z.T[:, own == stratum]
            grams[stratum] += part @ part.T
    return grams


def project(
    base: Baseline,
    columns: Sequence[FloatArray],
    grams: FloatArray | None = None,
    first: Sequence[FloatArray] | None = None,
) -> Projected:
    """Scores of some columns (for each block (n m, K)) after the baseline.

    Z~' Gamma Z~ = Z' Gamma Z - O' (Q' Gamma Z) - (Z' Gamma Q) O + O' (Q' Gamma Q) O,    O = Q' Z

    Parameters
    ----------
    base, columns : what is projected out of what.
    grams : ``stratum_grams`` of the columns, where they are known.
    first : columns (n m, k) of each block that are put before the others.
    """
    k = 0 if first is None else first[0].shape[1]
    p, count = base.upper.shape[0], k + columns[0].shape[1]
    overlap, weighted, score = np.zeros((p, count)), np.zeros((p, count)), np.zeros(count)
    gram, covariance = np.zeros((count, count)), np.zeros((count, count))
    inside, spread, left = np.zeros((p, p)), np.zeros((p, p)), np.zeros(p)
    known = grams is not None and grams.shape[0] == base.levels.size
    if known and grams is not None:
        gram[k:, k:] = grams.sum(axis=0)
        covariance[k:, k:] = np.tensordot(base.levels, grams, axes=1)
    for i, (q, z, r, gamma) in enumerate(zip(base.basis, columns, base.residual, base.gamma)):
        own = np.zeros((z.shape[0], 0)) if first is None else first[i]
        heavy, loud = q * gamma[:, None], own * gamma[:, None]
        beside = np.concatenate([q, heavy, r[:, None], own, loud], axis=1)
        for block, part in ((slice(k, None), z), (slice(0, k), own)):
            if part.shape[1] == 0:
                continue
            found = beside.T @ part
            overlap[:, block] += found[:p]
            weighted[:, block] += found[p : 2 * p]
            score[block] += found[2 * p]
            gram[:k, block] += found[2 * p + 1 : 2 * p + 1 + k]
            covariance[:k, block] += found[2 * p + 1 + k :]
            if not known and block.start == k:
                gram[k:, k:] += part.T @ part
                covariance[k:, k:] += part.T @ (part * gamma[:, None])
        inside += q.T @ q
        spread += q.T @ heavy
        left += q.T @ r
    gram[k:, :k], covariance[k:, :k] = gram[:k, k:].T, covariance[:k, k:].T
    norms = np.sqrt(np.maximum(np.diagonal(gram), 0.0))
    # Q' Q is the unit matrix but for rounding, which matters where little of a column survives.
    gram = gram - overlap.T @ overlap - overlap.T @ (np.eye(p) - inside) @ overlap
    cross = weighted.T @ overlap
    covariance = covariance - cross - cross.T + overlap.T @ spread @ overlap
    score = score - overlap.T @ left
    inverse = np.divide(1.0, norms, out=np.zeros(count), where=norms > 0.0)
    unit = np.outer(inverse, inverse)
    chi2 = sum(float(np.vdot(r, r)) for r in base.residual)
    gram, covariance = 0.5 * (gram + gram.T), 0.5 * (covariance + covariance.T)
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


def _gamma(fit: FitResult, residual: Sequence[FloatArray], dof: int) -> tuple[tuple[FloatArray, ...], FloatArray]:
    """gamma of each row, by block, and of each stratum."""
    if fit.strata is None or not fit.noise_known:
        return tuple(np.ones(r.size) for r in residual), np.zeros(0)
    strata = np.concatenate(fit.strata)
    counts = np.bincount(strata)
    energy = np.bincount(strata, weights=np.concatenate(residual) ** 2)
    # The fitted parameters' degrees of freedom are spread over the strata in proportion to their rows.
    expected = np.maximum(counts * (dof / strata.size), 1e-300)
    level = np.maximum(1.0, energy / expected)
    return tuple(level[part] for part in fit.strata), level
