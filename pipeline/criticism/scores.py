"""The score of every absent term, without refitting.

    T = max over the allowed theta of  2 s' theta - theta' G theta        expected fall of chi2
    theta^ = G^-1 s,   cov = G^-1 S G^-1                                  one-step estimate

Where a parameter may lie on one side of its null only, theta stays in that cone; where a parameter does not exist at the
null, T is the largest over its grid.  A term could have been seen at all if its SNR at the end of its declared range,
|reach| sqrt(G), is worth a detection.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from ..arrays import BoolArray, FloatArray, IntArray
from .problem import Candidate
from .projection import Projected

_RANK = 1e-9
#: Shares of a signature below this are rounding: the baseline takes all of it.
_GONE = 1e-6


@dataclass(frozen=True, eq=False)
class Face:
    """One face of the cone: the free parameters, the pseudo-inverse of their G, and the sides that must hold."""

    free: IntArray
    inverse: FloatArray
    sides: FloatArray


@dataclass(frozen=True, eq=False)
class Cell:
    """One grid point of one candidate.

    columns (k,) of the projected scores; faces of its cone; ``inflation`` = tr(G^+ S) / rank; ``rank`` of G.
    """

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
    delta_chi2 : expected fall of chi2.
    parameters : how many parameters it adds (k).
    estimate : parameter -> (value, sd) after one step; grid parameters with sd nan.
    log_p_single : log of its own p-value, the scan over its grid included.
    p_value : family-wise, over the largest of all candidates.
    surviving_share : of its signature, after the baseline.
    snr_at_reach : SNR at the end of its declared range; infinite where none is declared.
    detectable : these data could have shown it.
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


def cells_of(projected: Projected, candidate: Candidate) -> tuple[Cell, ...]:
    """The grid points of a candidate, ready for any number of scores."""
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
            faces.append(Face(free, _inverse(gram[np.ix_(free, free)])[0], sides[free]))
    inverse, rank = _inverse(gram)
    inflation = float(np.trace(inverse @ covariance)) / max(rank, 1)
    return Cell(columns, tuple(faces), max(inflation, 1.0), rank)


def _inverse(gram: FloatArray) -> tuple[FloatArray, int]:
    if gram.size == 0:
        return np.zeros_like(gram), 0
    size, vector = np.linalg.eigh(gram)
    good = size > max(_RANK * float(size[-1]), _GONE**2)
    return np.asarray((vector[:, good] / size[good]) @ vector[:, good].T), int(good.sum())


def delta_chi2s(cell: Cell, scores: FloatArray) -> tuple[FloatArray, FloatArray]:
    """T (n,) and theta (k, n) in scaled units, for scores (K, n) of which the cell takes its own."""
    own = scores[cell.columns]
    best, theta = np.zeros(own.shape[1]), np.zeros_like(own)
    for face in cell.faces:
        if face.free.size == 0:
            continue
        step = face.inverse @ own[face.free]
        fall = np.einsum("ij,ij->j", own[face.free], step)
        inside: BoolArray = np.all(step * face.sides[:, None] >= 0.0, axis=0) & (fall > best)
        best = np.where(inside, fall, best)
        full = np.zeros_like(own)
        full[face.free] = step
        theta = np.where(inside, full, theta)
    return best, theta


def estimate(
    projected: Projected, candidate: Candidate, cells: Sequence[Cell]
) -> tuple[int, dict[str, tuple[float, float]]]:
    """The best cell, and parameter -> (null + theta, sd) there, in the parameters' own units."""
    falls_here = [delta_chi2s(cell, projected.score[:, None]) for cell in cells]
    best = int(np.argmax([fall[0] for fall, _ in falls_here]))
    cell = cells[best]
    inverse, _ = _inverse(projected.gram[np.ix_(cell.columns, cell.columns)])
    covariance = inverse @ projected.covariance[np.ix_(cell.columns, cell.columns)] @ inverse
    sd = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    norms = np.where(projected.norms[cell.columns] > 0.0, projected.norms[cell.columns], np.inf)
    values = {
        parameter.name: (parameter.null + float(theta / norm), float(s / norm) if s > 0.0 else float("nan"))
        for parameter, theta, s, norm in zip(candidate.parameters, falls_here[best][1][:, 0], sd, norms)
    }
    values.update({name: (value, float("nan")) for name, value in candidate.grid[best].items()})
    return best, values


def visibility(projected: Projected, candidate: Candidate, cells: Sequence[Cell]) -> tuple[float, float]:
    """Surviving share, and SNR at reach, of the best-seen parameter over all cells."""
    share, snr = 0.0, 0.0
    for cell in cells:
        left = np.sqrt(np.maximum(np.diag(projected.gram)[cell.columns], 0.0))
        spread = np.sqrt(np.maximum(np.diag(projected.covariance)[cell.columns], 1e-300))
        reach = np.array([parameter.reach for parameter in candidate.parameters])
        seen = left > _GONE
        if not seen.any():
            continue
        share = max(share, float(left.max()))
        # The sd of a single parameter is sqrt(S)/G, so its SNR is reach norm G / sqrt(S).
        snr = max(snr, float(np.max((reach * projected.norms[cell.columns] * left**2 / spread)[seen])))
    return share, snr
