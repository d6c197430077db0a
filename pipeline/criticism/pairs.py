"""Pairs of absent terms, for the case that no single term is significant.

    T_ij = (s_i, s_j)' G_ij^+ (s_i, s_j),    p = P(min over all pairs of p* <= p_ij)

The null of the smallest p over all pairs is simulated as in ``significance``; one-sided parameters are taken as two-sided, which
is conservative.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from ..arrays import RANK
from .budget import DRAWS
from .problem import Candidate
from .scores import Projected
from .significance import log_tail


@dataclass(frozen=True)
class Pair:
    """Two terms, the decrease T of chi2 expected of both together, and the family-wise p over all pairs."""

    names: tuple[str, str]
    delta_chi2: float
    p_value: float


def best_pairs(
    projected: Projected, candidates: Sequence[Candidate], known: bool, draws: int = DRAWS, seed: int = 0
) -> tuple[Pair, ...]:
    """All pairs of candidates without a grid, most significant first.

    Parameters
    ----------
    projected : scores (K,) of the columns of all candidates, and their covariance (K, K).
    candidates : absent terms.
    known : the noise level is known.
    draws, seed : number of simulated score vectors, and the seed of the simulation.
    """
    plain = [candidate for candidate in candidates if len(candidate.cells) == 1]
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(0x2A125,)))
    size, vector = np.linalg.eigh(projected.covariance)
    good = size > 1e-13 * max(float(size[-1]), 1e-300) if size.size else np.zeros(0, dtype=bool)
    root = vector[:, good] * np.sqrt(size[good])
    normal = rng.standard_normal((root.shape[1], draws))
    # The observed scores are the last column, after the simulated ones.
    scores = np.concatenate([root @ normal, projected.score[:, None]], axis=1)
    total = np.full(draws + 1, projected.chi2)
    total[:-1] = np.sum(normal**2, axis=0) + rng.chisquare(max(projected.dof - root.shape[1], 0) or 1e-9, draws)
    every = np.arange(projected.score.size)
    smallest, tested = np.zeros(draws), []
    for one, other in combinations(plain, 2):
        columns = np.concatenate([every[one.cells[0]], every[other.cells[0]]])
        gram = projected.gram[np.ix_(columns, columns)]
        lam, v = np.linalg.eigh(gram)
        kept = lam > RANK * max(float(lam[-1]), 1e-300)
        rank = int(kept.sum())
        whiten = (v[:, kept] / np.sqrt(lam[kept])).T
        inflation = float(np.trace(whiten @ projected.covariance[np.ix_(columns, columns)] @ whiten.T)) / max(rank, 1)
        decrease = np.sum((whiten @ scores[columns]) ** 2, axis=0)
        dof = projected.dof - rank
        if rank == 0 or (not known and dof <= 0):
            continue
        if known:
            log_p = log_tail(decrease / max(inflation, 1.0), rank)
        else:
            log_p = log_tail(decrease * dof / np.maximum(total - decrease, 1e-300), rank, dof)
        smallest = np.minimum(smallest, log_p[:-1])
        tested.append((float(log_p[-1]), float(decrease[-1]), (one.name, other.name)))
    smallest.sort()
    return tuple(
        Pair(names, delta_chi2, (int(np.searchsorted(smallest, log_p, side="right")) + 1) / (draws + 1))
        for log_p, delta_chi2, names in sorted(tested)
    )
