"""Terms that many units share: the scores of all units together, although a single unit has too little evidence.

Unit i has, for the columns of a term, a score s_i, its information G_i and its covariance C_i, with the unit's own parameters
projected out (``scores``).  At the null, s_i has mean 0 and covariance C_i; for a term of size theta_i, its mean is G_i theta_i.

    common   T = (sum s_i)' (sum C_i)^+ (sum s_i)          chi2_k        one size for all units
    spread   Q = sum s_i' C_i^+ s_i                        chi2_{nk}     a size of either sign for each unit

The better of both counts (p = 2 min).  C_i is multiplied by the dispersion of the scores where that exceeds 1.  A term is shared
when its p is family-wise significant and remains so without the most significant units, as many as represent a tenth of the
population and at least one: what one odd unit (or a few of many) has is not shared.  Units that are each significant by
themselves and together represent less than a tenth are set aside first, so that they neither create nor mask a shared term.

Shapes: n units, K columns in all, k of a term.  ``weights`` (n,): number of units of the population that each represents.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from ..arrays import RANK, BoolArray, FloatArray
from .significance import log_any, log_tail

#: A term that a smaller share of the population has is not shared.
MIN_PREVALENCE = 0.1


@dataclass(frozen=True)
class SharedTerm:
    """A term: its columns, and for each the side (+1 or -1) on which it exists, or 0 for both."""

    name: str
    columns: tuple[int, ...]
    sides: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Evidence:
    """Scores of n units, per unit of each parameter.

    Parameters
    ----------
    score : (n, K); a column that a unit lacks is zero.
    information, covariance : (n, K, K) G_i and C_i.
    weights : (n,) number of units of the population that each represents.
    """

    score: FloatArray
    information: FloatArray
    covariance: FloatArray
    weights: FloatArray

    def scaled(self) -> tuple[Evidence, FloatArray]:
        """The same with columns of unit mean information, and the scale (K,) by which they were divided [1 / unit]."""
        mean = np.sqrt(np.maximum(np.mean(np.diagonal(self.information, axis1=1, axis2=2), axis=0), 0.0))
        scale = np.where(mean > 0.0, mean, 1.0)
        present = np.diagonal(self.information, axis1=1, axis2=2) > RANK * scale**2
        both = np.where(present[:, :, None] & present[:, None, :], 1.0, 0.0) / np.outer(scale, scale)
        score = np.where(present, self.score / scale, 0.0)
        return Evidence(score, self.information * both, self.covariance * both, self.weights), scale

    def of(self, units: BoolArray) -> Evidence:
        """The units selected by a mask (n,)."""
        return Evidence(self.score[units], self.information[units], self.covariance[units], self.weights[units])


@dataclass(frozen=True)
class Joint:
    """Joint test of one term on all units.

    Parameters
    ----------
    name : of the term.
    log_p_common, log_p_spread : of T and Q.
    log_p : of the better of both, by Bonferroni.
    log_p_without : the same without the most significant units.
    size, size_sd : common size of each column and its sd, in the unit of the parameter.
    right_side : the common size is on the side where the term exists.
    """

    name: str
    log_p_common: float
    log_p_spread: float
    log_p: float
    log_p_without: float
    size: tuple[float, ...]
    size_sd: tuple[float, ...]
    right_side: bool

    def log_p_family(self, count: float) -> float:
        """The larger of ``log_p`` and ``log_p_without`` as the smallest of ``count`` terms: log(1 - (1 - p)^count)."""
        return max(float(log_any(p, count)) for p in (self.log_p, self.log_p_without))


@dataclass(frozen=True)
class Shared:
    """The shared term, if any.

    Parameters
    ----------
    found : the most significant shared term, or ``None``.
    rivals : terms that could replace ``found``.
    nearest, log_p_any : name of the most significant term, and its log p with the number of terms counted, no unit left out.
    aside : (n,) units that were set aside as odd.
    """

    found: Joint | None
    rivals: tuple[str, ...]
    nearest: str
    log_p_any: float
    aside: tuple[bool, ...]


def shared(
    evidence: Evidence, terms: Sequence[SharedTerm], population: float, alpha: float, trials: float = 1.0
) -> Shared:
    """Find the term that the units share, if any.

    Parameters
    ----------
    evidence : scores of n units.
    terms : E candidates and their columns among the K.
    population : number of units in all, of which a tenth is the smallest share that counts.
    alpha : family-wise probability of naming a term where none is shared.
    trials : number of families of terms that are tested.
    """
    if not terms or evidence.score.shape[0] == 0:
        return Shared(None, (), "", 0.0, (False,) * evidence.score.shape[0])
    whole, scale = evidence.scaled()
    single_log_p, dispersion = _single_units(whole, terms)
    budget = MIN_PREVALENCE * population
    odd = np.asarray(log_any(single_log_p.min(axis=1), float(len(terms))) < np.log(alpha))
    if whole.weights[odd].sum() > budget:
        odd = np.zeros_like(odd)
    kept = whole.of(~odd)
    left = max(budget - float(whole.weights[odd].sum()), 0.0)
    joints = [_joint(kept, term, scale, dispersion, left) for term in terms]
    order = sorted(range(len(terms)), key=lambda i: joints[i].log_p)
    count = float(len(terms)) * trials
    found = next((i for i in order if joints[i].right_side and joints[i].log_p_family(count) < np.log(alpha)), None)
    rivals: tuple[str, ...] = ()
    if found is not None:
        others = [term for i, term in enumerate(terms) if i != found]
        rivals = tuple(o.name for o in others if _replaces(kept, terms[found], o, dispersion, alpha))
    return Shared(
        None if found is None else joints[found],
        rivals,
        joints[order[0]].name,
        float(log_any(joints[order[0]].log_p, float(len(terms)))),
        tuple(odd.tolist()),
    )


def _single_units(whole: Evidence, terms: Sequence[SharedTerm]) -> tuple[FloatArray, float]:
    """log p of each unit and term (n, E), and the dispersion: the median over terms of the median over units.

    The dispersion is taken from what each term adds to the strongest one, because a shared term is not dispersion.
    """
    log_p = np.zeros((whole.score.shape[0], len(terms)))
    delta_chi2s, ranks = zip(*(_delta_chi2s(whole, term.columns) for term in terms))
    for j, (decrease, rank) in enumerate(zip(delta_chi2s, ranks)):
        for k in np.unique(rank[rank > 0]):
            log_p[rank == k, j] = log_tail(decrease[rank == k], int(k))
    best = int(np.argmax([np.median(decrease - rank) for decrease, rank in zip(delta_chi2s, ranks)]))
    excess = []
    for term in (term for j, term in enumerate(terms) if j != best):
        both, rank = _delta_chi2s(whole, (*term.columns, *terms[best].columns))
        added, larger = both - delta_chi2s[best], rank > ranks[best]
        if larger.any():
            excess.append(float(np.median(added[larger] / chdtri((rank - ranks[best])[larger], 0.5))))
    return log_p, max(1.0, float(np.median(excess)) if excess else 1.0)


def _delta_chi2s(evidence: Evidence, columns: Sequence[int]) -> tuple[FloatArray, FloatArray]:
    """s_i' C_i^+ s_i (n,) and the ranks (n,)."""
    own = list(columns)
    return _quadratic(evidence.score[:, own], evidence.covariance[:, own][:, :, own])


def _inverses(matrices: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Pseudo-inverses (n, k, k) and ranks (n,) of symmetric matrices."""
    size, vector = np.linalg.eigh(matrices)
    good = size > RANK * np.maximum(size[:, -1:], 1e-300)
    good &= size > 0.0
    inverse = np.where(good, 1.0 / np.where(good, size, 1.0), 0.0)
    return np.einsum("nij,nj,nkj->nik", vector, inverse, vector), good.sum(axis=1).astype(np.float64)


def _quadratic(score: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """s' C^+ s and rank (m,) of m pairs (m, k), (m, k, k)."""
    inverse, rank = _inverses(covariance)
    return np.einsum("ni,nij,nj->n", score, inverse, score), rank


def _joint(kept: Evidence, term: SharedTerm, scale: FloatArray, dispersion: float, budget: float) -> Joint:
    own = list(term.columns)
    score = kept.score[:, own]
    information = kept.information[:, own][:, :, own]
    covariance = kept.covariance[:, own][:, :, own] * dispersion
    delta_chi2s, ranks = _delta_chi2s(kept, own)
    delta_chi2s = delta_chi2s / dispersion
    common, spread = _log_common(score, covariance), _log_spread(delta_chi2s, ranks)
    without = min(
        _log_common(*_without_strongest_common(score, covariance, kept.weights, budget)),
        _log_spread(*_without_strongest_spread(delta_chi2s, ranks, kept.weights, budget)),
    )
    inverse = _inverses(information.sum(axis=0)[None])[0][0]
    size = inverse @ score.sum(axis=0)
    sd = np.sqrt(np.maximum(np.diag(inverse @ covariance.sum(axis=0) @ inverse), 0.0))
    units = scale[own]
    return Joint(
        term.name,
        common,
        spread,
        min(min(common, spread) + math.log(2.0), 0.0),
        min(without + math.log(2.0), 0.0),
        tuple((size / units).tolist()),
        tuple((sd / units).tolist()),
        all(side == 0 or side * value > 0.0 for side, value in zip(term.sides, size.tolist())),
    )


def _log_common(score: FloatArray, covariance: FloatArray) -> float:
    if score.shape[0] == 0:
        return 0.0
    total, rank = _quadratic(score.sum(axis=0)[None], covariance.sum(axis=0)[None])
    return float(log_tail(total, int(rank[0]))[0]) if rank[0] else 0.0


def _log_spread(delta_chi2s: FloatArray, ranks: FloatArray) -> float:
    dof = int(ranks.sum())
    return float(log_tail(float(delta_chi2s.sum()), dof)) if dof else 0.0


def _without_strongest_common(
    score: FloatArray, covariance: FloatArray, weights: FloatArray, budget: float
) -> tuple[FloatArray, FloatArray]:
    """Scores and covariances without the units whose removal lowers T most."""
    kept = np.ones(score.shape[0], dtype=np.bool_)
    left, first = budget, True
    while kept.any():
        removable = kept & ((weights <= left) | first)
        if not removable.any():
            break
        total, spread = score[kept].sum(axis=0), covariance[kept].sum(axis=0)
        places = np.flatnonzero(removable)
        statistics, _ = _quadratic(total - score[places], spread - covariance[places])
        place = int(places[int(np.argmin(statistics))])
        kept[place], first = False, False
        left -= float(weights[place])
    return score[kept], covariance[kept]


def _without_strongest_spread(
    delta_chi2s: FloatArray, ranks: FloatArray, weights: FloatArray, budget: float
) -> tuple[FloatArray, FloatArray]:
    """delta_chi2 and ranks without the units of the largest delta_chi2."""
    kept = np.ones(delta_chi2s.size, dtype=np.bool_)
    left, first = budget, True
    for place in np.argsort(-delta_chi2s, kind="stable"):
        if first or weights[place] <= left:
            kept[place], first = False, False
            left -= float(weights[place])
    return delta_chi2s[kept], ranks[kept]


def _replaces(kept: Evidence, term: SharedTerm, other: SharedTerm, dispersion: float, alpha: float) -> bool:
    """Whether T(term | other) is insignificant, with one size for all units and with one for each."""
    both = [*term.columns, *other.columns]
    second = list(other.columns)
    score, covariance = kept.score.sum(axis=0), kept.covariance.sum(axis=0)
    joint, rank = _quadratic(score[both][None], covariance[np.ix_(both, both)][None])
    alone, rank_alone = _quadratic(score[second][None], covariance[np.ix_(second, second)][None])
    each, ranks = _delta_chi2s(kept, both)
    each_alone, ranks_alone = _delta_chi2s(kept, second)
    log_p = [0.0]
    if rank[0] > rank_alone[0]:
        log_p.append(float(log_tail(float(joint[0] - alone[0]) / dispersion, int(rank[0] - rank_alone[0]))))
    dof = int((ranks - ranks_alone).sum())
    if dof > 0:
        log_p.append(float(log_tail(float((each - each_alone).sum()) / dispersion, dof)))
    return min(log_p) > np.log(alpha)


def still_needed(sizes: FloatArray, sds: FloatArray, weights: FloatArray, population: float, alpha: float) -> bool:
    """Whether fitted sizes (n,) of one parameter, with sd (n,), are together significantly different from zero."""
    known = np.isfinite(sizes) & np.isfinite(sds) & (sds > 0.0)
    information = (1.0 / sds[known] ** 2)[:, None, None]
    evidence = Evidence((sizes[known] / sds[known] ** 2)[:, None], information, information, weights[known])
    return shared(evidence, [SharedTerm("parameter", (0,), (0,))], population, alpha).found is not None
