"""Scores of columns that a model lacks, with the columns that it has (the baseline) projected out; nothing is refitted.

    Q R = J,   Z~ = (1 - Q Q') Z,   s = Z~' r,   G = Z~' Z~,   S = Z~' Gamma Z~
    T   = max over the allowed theta of  2 s' theta - theta' G theta        expected decrease of chi2

The covariance of the score s is G for white noise of unit variance, and S where the variance in stratum g is gamma_g:

    gamma_g = max(1, sum of r^2 over the stratum / its degrees of freedom)

A misfit in a few of many rows hardly changes gamma, and gamma is at least 1, so a wrong noise level cannot create evidence.
A parameter that exists on one side of its null only restricts theta to a cone; its faces are tried one by one.

Shapes: a block has n m rows; P columns of J of rank p; K columns of Z; k columns of one candidate.  Everything is in sigmas.
Sources: score test (Rao 1948); parameters on a boundary (Chernoff 1954).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations

import numpy as np

from ..arrays import RANK, BoolArray, FloatArray, IntArray
from .problem import Candidate, FitResult

#: A surviving share below this is the error of the columns: the baseline absorbs the whole signature.
ABSORBED = float(np.sqrt(RANK))


@dataclass(frozen=True, eq=False)
class Baseline:
    """Orthonormal columns of the jacobian, block by block.

    Parameters
    ----------
    basis : for each block (n m, p).
    upper : (p, P), J = basis upper.
    residual : for each block (n m,), projected.
    gamma : for each block (n m,) the noise variance.
    levels : gamma of each stratum; empty without strata.
    dof : degrees of freedom of the projected residual.
    """

    basis: tuple[FloatArray, ...]
    upper: FloatArray
    residual: tuple[FloatArray, ...]
    gamma: tuple[FloatArray, ...]
    levels: FloatArray
    dof: int


@dataclass(frozen=True, eq=False)
class Projected:
    """Scores of columns of Z that are scaled to unit norm, the baseline projected out.

    Parameters
    ----------
    score : (K,).
    gram, covariance : (K, K) G and S.
    norms : (K,) of Z before scaling and projection, so that sqrt(diag(G)) is the share that survives the projection.
    chi2, dof : of the projected residual.
    """

    score: FloatArray
    gram: FloatArray
    covariance: FloatArray
    norms: FloatArray
    chi2: float
    dof: int


@dataclass(frozen=True, eq=False)
class Face:
    """A face of the cone: indices (f,) of its free parameters, their G^+ (f, f), and their sides (f,) +1, -1 or 0."""

    free: IntArray
    inverse: FloatArray
    sides: FloatArray


@dataclass(frozen=True, eq=False)
class Cell:
    """One grid point of one candidate: columns (k,), faces of its cone, inflation tr(G^+ S) / rank, and the rank of G."""

    columns: IntArray
    faces: tuple[Face, ...]
    inflation: float
    rank: int


@dataclass(frozen=True)
class Score:
    """What the data say about one absent term without a refit.

    Parameters
    ----------
    name : of the term.
    delta_chi2 : expected decrease of chi2.
    parameters : number of parameters that it adds, scanned ones included.
    estimate : parameter -> (value, sd) after one step, in its own unit; the sd of a scanned parameter is nan.
    log_p_single : log of its own p-value, the scan over its grid included.
    p_value : family-wise, over all candidates.
    surviving_share : share of the norm of its signature that the baseline does not absorb.
    snr_at_reach : SNR at the end of its range (``TermParameter.reach``); infinite where none is declared.
    detectable : the SNR at the end of its range is large enough for a detection.
    """

    name: str
    delta_chi2: float
    parameters: int
    estimate: Mapping[str, tuple[float, float]]
    log_p_single: float
    p_value: float
    surviving_share: float
    snr_at_reach: float
    detectable: bool


@lru_cache(maxsize=2)
def baseline(fit: FitResult, without: tuple[int, ...] = ()) -> Baseline:
    """Q and R of the jacobian of a fit, J = Q R, without the columns ``without``; residual r - Q Q' r.

    A second pass removes the rounding error of the first, so that a signature of which a millionth survives is still right.
    The last two results are cached because several tests of one fit use the same baseline.
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


def project(
    base: Baseline,
    columns: Sequence[FloatArray],
    grams: FloatArray | None = None,
    first: Sequence[FloatArray] | None = None,
) -> Projected:
    """Scores of columns with the baseline projected out.

    Z~' Gamma Z~ = Z' Gamma Z - O' (Q' Gamma Z) - (Z' Gamma Q) O + O' (Q' Gamma Q) O,    O = Q' Z

    Parameters
    ----------
    base : baseline to project out.
    columns : for each block Z_b (n m, K).
    grams : ``stratum_grams`` of the columns (strata, K, K), where known.
    first : for each block (n m, k) columns that precede the others in the result.
    """
    k = 0 if first is None else first[0].shape[1]
    p, count = base.upper.shape[0], k + columns[0].shape[1]
    overlap, weighted, score = np.zeros((p, count)), np.zeros((p, count)), np.zeros(count)
    gram, covariance = np.zeros((count, count)), np.zeros((count, count))
    basis_gram, basis_covariance, basis_score = np.zeros((p, p)), np.zeros((p, p)), np.zeros(p)
    known = grams is not None and grams.shape[0] == base.levels.size
    if known and grams is not None:
        gram[k:, k:] = grams.sum(axis=0)
        covariance[k:, k:] = np.tensordot(base.levels, grams, axes=1)
    for i, (q, z, r, gamma) in enumerate(zip(base.basis, columns, base.residual, base.gamma)):
        own = np.zeros((z.shape[0], 0)) if first is None else first[i]
        q_gamma, own_gamma = q * gamma[:, None], own * gamma[:, None]
        left = np.concatenate([q, q_gamma, r[:, None], own, own_gamma], axis=1)
        for block, part in ((slice(k, None), z), (slice(0, k), own)):
            if part.shape[1] == 0:
                continue
            products = left.T @ part
            overlap[:, block] += products[:p]
            weighted[:, block] += products[p : 2 * p]
            score[block] += products[2 * p]
            gram[:k, block] += products[2 * p + 1 : 2 * p + 1 + k]
            covariance[:k, block] += products[2 * p + 1 + k :]
            if not known and block.start == k:
                gram[k:, k:] += part.T @ part
                covariance[k:, k:] += part.T @ (part * gamma[:, None])
        basis_gram += q.T @ q
        basis_covariance += q.T @ q_gamma
        basis_score += q.T @ r
    gram[k:, :k], covariance[k:, :k] = gram[:k, k:].T, covariance[:k, k:].T
    norms = np.sqrt(np.maximum(np.diagonal(gram), 0.0))
    # Q' Q differs from the unit matrix by rounding only, which matters where little of a column survives.
    gram = gram - overlap.T @ overlap - overlap.T @ (np.eye(p) - basis_gram) @ overlap
    cross = weighted.T @ overlap
    covariance = covariance - cross - cross.T + overlap.T @ basis_covariance @ overlap
    score = score - overlap.T @ basis_score
    inverse = np.divide(1.0, norms, out=np.zeros(count), where=norms > 0.0)
    unit = np.outer(inverse, inverse)
    chi2 = sum(float(np.vdot(r, r)) for r in base.residual)
    gram, covariance = 0.5 * (gram + gram.T), 0.5 * (covariance + covariance.T)
    return Projected(score * inverse, gram * unit, covariance * unit, norms, chi2, base.dof)


def _orthonormal(blocks: Sequence[FloatArray]) -> tuple[tuple[FloatArray, ...], FloatArray]:
    """Q by blocks and the factor T (p, P) with J = Q T; directions below the rank tolerance are dropped."""
    if blocks[0].shape[1] == 0:
        return tuple(blocks), np.zeros((0, 0))
    stacked = np.concatenate([triangle(block) for block in blocks])
    upper = triangle(stacked)
    scale = np.linalg.norm(upper, axis=0)
    scale[scale == 0.0] = 1.0
    _, size, vt = np.linalg.svd(upper / scale)
    rank = int(np.sum(size > RANK * size.max(initial=0.0))) if size.size else 0
    factor = size[:rank, None] * vt[:rank]
    inverse = vt[:rank].T / size[:rank] / scale[:, None]
    return tuple(block @ inverse for block in blocks), factor * scale


def triangle(matrix: FloatArray) -> FloatArray:
    """R (k, k) of the QR factorisation of a matrix (n, k); (n, k) where n < k."""
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
    # The degrees of freedom of the fitted parameters are shared among the strata in proportion to their rows.
    expected = np.maximum(counts * (dof / strata.size), 1e-300)
    level = np.maximum(1.0, energy / expected)
    return tuple(level[part] for part in fit.strata), level


def cells_of(projected: Projected, candidate: Candidate) -> tuple[Cell, ...]:
    """The grid points of a candidate: their columns, cones and inflation, for use with any number of scores."""
    return tuple(_cell(projected, candidate, part) for part in candidate.cells)


def _cell(projected: Projected, candidate: Candidate, part: slice) -> Cell:
    columns = np.arange(projected.score.size)[part]
    gram = projected.gram[np.ix_(columns, columns)]
    covariance = projected.covariance[np.ix_(columns, columns)]
    sides = np.array([parameter.side for parameter in candidate.parameters], dtype=np.float64)
    bound = np.flatnonzero(sides)
    faces = []
    for count in range(bound.size + 1):
        for dropped in combinations(bound.tolist(), count):
            free = np.array([j for j in range(columns.size) if j not in dropped], dtype=np.int64)
            faces.append(Face(free, inverse_of(gram[np.ix_(free, free)])[0], sides[free]))
    inverse, rank = inverse_of(gram)
    inflation = float(np.trace(inverse @ covariance)) / max(rank, 1)
    return Cell(columns, tuple(faces), max(inflation, 1.0), rank)


def inverse_of(gram: FloatArray) -> tuple[FloatArray, int]:
    """G^+ (k, k) and its rank for a block (k, k) of G; directions that the baseline absorbs are dropped."""
    if gram.size == 0:
        return np.zeros_like(gram), 0
    size, vector = np.linalg.eigh(gram)
    good = size > RANK * max(float(size[-1]), 1.0)
    return np.asarray((vector[:, good] / size[good]) @ vector[:, good].T), int(good.sum())


def largest_delta_chi2s(cell: Cell, scores: FloatArray) -> FloatArray:
    """T (n,) of :func:`delta_chi2s` without theta: all that a simulated null needs."""
    own = scores[cell.columns]
    best = np.zeros(own.shape[1])
    for face in cell.faces:
        if face.free.size == 0:
            continue
        step = face.inverse @ own[face.free]
        decrease = np.einsum("ij,ij->j", own[face.free], step)
        if face.sides.any():
            decrease = np.where(np.all(step * face.sides[:, None] >= 0.0, axis=0), decrease, 0.0)
        best = np.fmax(best, decrease)
    return best


def delta_chi2s(cell: Cell, scores: FloatArray) -> tuple[FloatArray, FloatArray]:
    """T (n,) and theta (k, n) of a cell in scaled units, for n scores (K, n) of all columns."""
    own = scores[cell.columns]
    best, theta = np.zeros(own.shape[1]), np.zeros_like(own)
    for face in cell.faces:
        if face.free.size == 0:
            continue
        step = face.inverse @ own[face.free]
        decrease = np.einsum("ij,ij->j", own[face.free], step)
        inside: BoolArray = np.all(step * face.sides[:, None] >= 0.0, axis=0) & (decrease > best)
        best = np.where(inside, decrease, best)
        full = np.zeros_like(own)
        full[face.free] = step
        theta = np.where(inside, full, theta)
    return best, theta
