"""Terms that many units share: the scores of all of them together, though a single one has too little evidence.

Unit i has, for the columns of a term, a score s_i, its information G_i and its covariance C_i, the unit's own parameters
projected out (``projection``).  Where the term is null, s_i has mean 0 and covariance C_i; where its size is theta_i, mean
G_i theta_i.

    common   T = (sum s_i)' (sum C_i)^+ (sum s_i)          chi2_k        one size for all
    spread   Q = sum s_i' C_i^+ s_i                        chi2_{nk}     a size of its own for each, of either sign

Both are judged (p = 2 min), with C_i times the dispersion of the scores where that is above 1.  A term is shared when its p is
family-wise significant and stays so without the most telling units, as many as stand for a tenth of the population, one at
least: what one odd unit has (or a few of many) is its own.  Units that are each significant and together stand for less than
that tenth are set aside first, so that they neither make nor mask what the others share.

Shapes: n units, K columns in all, k of a term.  ``weights`` (n,): how many units of the population each stands for.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from ..arrays import BoolArray, FloatArray
from .tails import log_any, log_tail

#: What is carried by less than this share of the population is not shared.
TENTH = 0.1
_RANK = 1e-9
#: A column of which a unit shows less than this share of what units show on average is not seen there at all.
_UNSEEN = 1e-12


@dataclass(frozen=True)
class SharedTerm:
    """A term: its columns, and for each +1 or -1 where only that side of the null exists, else 0."""

    name: str
    columns: tuple[int, ...]
    sides: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Evidence:
    """Scores (n, K), their information and covariance (n, K, K), and the units' weights (n,).

    In the terms' own units; a column that a unit does not have is zero there.
    """

    score: FloatArray
    information: FloatArray
    covariance: FloatArray
    weights: FloatArray

    def scaled(self) -> tuple[Evidence, FloatArray]:
        """The same with columns in units of their mean information, and those units (K,)."""
        mean = np.sqrt(np.maximum(np.mean(np.diagonal(self.information, axis1=1, axis2=2), axis=0), 0.0))
        scale = np.where(mean > 0.0, mean, 1.0)
        seen = np.diagonal(self.information, axis1=1, axis2=2) > _UNSEEN * scale**2
        both = np.where(seen[:, :, None] & seen[:, None, :], 1.0, 0.0) / np.outer(scale, scale)
        score = np.where(seen, self.score / scale, 0.0)
        return Evidence(score, self.information * both, self.covariance * both, self.weights), scale

    def of(self, units: BoolArray) -> Evidence:
        """Some of the units."""
        return Evidence(self.score[units], self.information[units], self.covariance[units], self.weights[units])


@dataclass(frozen=True)
class Joint:
    """What all units say of one term.

    Parameters
    ----------
    name : of the term.
    log_p_common, log_p_spread : of T and Q.
    log_p : of the better of both, Bonferroni's two counted.
    log_p_without : the same without the most telling units.
    size, size_sd : the common size of each column, in its own unit.
    right_side : the common size lies where the term exists.
    """

    name: str
    log_p_common: float
    log_p_spread: float
    log_p: float
    log_p_without: float
    size: tuple[float, ...]
    size_sd: tuple[float, ...]
    right_side: bool


@dataclass(frozen=True)
class Shared:
    """What units share.

    Parameters
    ----------
    terms : all that were judged, most significant first; ``nearest`` is the name of the first.
    found : the best of those that are shared, or ``None``.
    rivals : terms that could stand for ``found``.
    log_p_any : its log p, no unit left out, every term counted.
    aside : (n,) units that were set aside as odd.
    dispersion : of the scores, at least 1.
    """

    terms: tuple[Joint, ...]
    found: Joint | None
    rivals: tuple[str, ...]
    nearest: str
    log_p_any: float
    aside: tuple[bool, ...]
    dispersion: float


def shared(
    evidence: Evidence, terms: Sequence[SharedTerm], population: float, alpha: float, trials: float = 1.0
) -> Shared:
    """Find the term that the units share, if any.

    Parameters
    ----------
    evidence : of n units.
    terms : candidates.
    population : how many units there are in all; a tenth of them is not "many".
    alpha : family-wise probability of naming a term where there is none.
    trials : how many such families are looked at.
    """
    if not terms or evidence.score.shape[0] == 0:
        return Shared((), None, (), "", 0.0, (False,) * evidence.score.shape[0], 1.0)
    whole, scale = evidence.scaled()
    alone, dispersion = _alone(whole, terms)
    budget = TENTH * population
    odd = np.asarray(log_any(alone.min(axis=1), float(len(terms))) < np.log(alpha))
    if whole.weights[odd].sum() > budget:
        odd = np.zeros_like(odd)
    kept = whole.of(~odd)
    left = max(budget - float(whole.weights[odd].sum()), 0.0)
    joints = [_judged(kept, term, scale, dispersion, left) for term in terms]
    order = sorted(range(len(terms)), key=lambda i: joints[i].log_p)
    count = float(len(terms)) * trials
    found = next(
        (
            i
            for i in order
            if joints[i].right_side
            and max(float(log_any(p, count)) for p in (joints[i].log_p, joints[i].log_p_without)) < np.log(alpha)
        ),
        None,
    )
    rivals: tuple[str, ...] = ()
    if found is not None:
        others = [term for i, term in enumerate(terms) if i != found]
        rivals = tuple(o.name for o in others if _stands_for(kept, terms[found], o, dispersion, alpha))
    return Shared(
        tuple(joints[i] for i in order),
        None if found is None else joints[found],
        rivals,
        joints[order[0]].name,
        float(log_any(joints[order[0]].log_p, float(len(terms)))),
        tuple(odd.tolist()),
        dispersion,
    )


def _alone(whole: Evidence, terms: Sequence[SharedTerm]) -> tuple[FloatArray, float]:
    """log p of each unit and term (n, E), and the dispersion of typical units over typical terms.

    The dispersion is that of what each term adds to the one that falls furthest: what is shared is no dispersion.
    """
    log_p = np.zeros((whole.score.shape[0], len(terms)))
    delta_chi2s, ranks = zip(*(_falls(whole, term.columns) for term in terms))
    for j, (fall, rank) in enumerate(zip(delta_chi2s, ranks)):
        for k in np.unique(rank[rank > 0]):
            log_p[rank == k, j] = log_tail(fall[rank == k], int(k))
    best = int(np.argmax([np.median(fall - rank) for fall, rank in zip(delta_chi2s, ranks)]))
    excess = []
    for term in (term for j, term in enumerate(terms) if j != best):
        both, rank = _falls(whole, (*term.columns, *terms[best].columns))
        more, seen = both - delta_chi2s[best], rank > ranks[best]
        if seen.any():
            excess.append(float(np.median(more[seen] / chi2.median((rank - ranks[best])[seen]))))
    return log_p, max(1.0, float(np.median(excess)) if excess else 1.0)


def _falls(evidence: Evidence, columns: Sequence[int]) -> tuple[FloatArray, FloatArray]:
    """s_i' C_i^+ s_i (n,) and the ranks (n,)."""
    own = list(columns)
    score, covariance = evidence.score[:, own], evidence.covariance[:, own][:, :, own]
    inverse, rank = _inverses(covariance)
    return np.einsum("ni,nij,nj->n", score, inverse, score), rank


def _inverses(matrices: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Pseudo-inverses (n, k, k) and ranks (n,) of symmetric matrices."""
    size, vector = np.linalg.eigh(matrices)
    good = size > _RANK * np.maximum(size[:, -1:], 1e-300)
    good &= size > 0.0
    inverse = np.where(good, 1.0 / np.where(good, size, 1.0), 0.0)
    return np.einsum("nij,nj,nkj->nik", vector, inverse, vector), good.sum(axis=1).astype(np.float64)


def _quadratic(score: FloatArray, covariance: FloatArray) -> tuple[FloatArray, int]:
    """s' C^+ s of m pairs (m, k), (m, k, k); and the largest rank."""
    inverse, rank = _inverses(covariance)
    return np.einsum("ni,nij,nj->n", score, inverse, score), int(rank.max(initial=0.0))


def _judged(kept: Evidence, term: SharedTerm, scale: FloatArray, dispersion: float, budget: float) -> Joint:
    own = list(term.columns)
    score = kept.score[:, own]
    information = kept.information[:, own][:, :, own]
    covariance = kept.covariance[:, own][:, :, own] * dispersion
    delta_chi2s, ranks = _falls(kept, own)
    delta_chi2s = delta_chi2s / dispersion
    common, spread = _log_common(score, covariance), _log_spread(delta_chi2s, ranks)
    without = min(
        _log_common(*_less(score, covariance, kept.weights, budget)),
        _log_spread(*_least(delta_chi2s, ranks, kept.weights, budget)),
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
    return float(log_tail(total, rank)[0]) if rank else 0.0


def _log_spread(delta_chi2s: FloatArray, ranks: FloatArray) -> float:
    dof = int(ranks.sum())
    return float(log_tail(float(delta_chi2s.sum()), dof)) if dof else 0.0


def _less(
    score: FloatArray, covariance: FloatArray, weights: FloatArray, budget: float
) -> tuple[FloatArray, FloatArray]:
    """Scores and covariances without the units whose leaving takes most from T."""
    kept = np.ones(score.shape[0], dtype=np.bool_)
    left, first = budget, True
    while kept.any():
        may = kept & ((weights <= left) | first)
        if not may.any():
            break
        total, spread = score[kept].sum(axis=0), covariance[kept].sum(axis=0)
        places = np.flatnonzero(may)
        rest, _ = _quadratic(total - score[places], spread - covariance[places])
        place = int(places[int(np.argmin(rest))])
        kept[place], first = False, False
        left -= float(weights[place])
    return score[kept], covariance[kept]


def _least(
    delta_chi2s: FloatArray, ranks: FloatArray, weights: FloatArray, budget: float
) -> tuple[FloatArray, FloatArray]:
    """Falls and ranks without the units of the largest falls."""
    kept = np.ones(delta_chi2s.size, dtype=np.bool_)
    left, first = budget, True
    for place in np.argsort(-delta_chi2s, kind="stable"):
        if first or weights[place] <= left:
            kept[place], first = False, False
            left -= float(weights[place])
    return delta_chi2s[kept], ranks[kept]


def _stands_for(kept: Evidence, term: SharedTerm, other: SharedTerm, dispersion: float, alpha: float) -> bool:
    """Whether ``other`` leaves nothing of ``term``: T(term | other), with one size for all and with one for each."""
    both = [*term.columns, *other.columns]
    second = list(other.columns)
    score, covariance = kept.score.sum(axis=0), kept.covariance.sum(axis=0)
    joint, rank = _quadratic(score[both][None], covariance[np.ix_(both, both)][None])
    lone, rank_lone = _quadratic(score[second][None], covariance[np.ix_(second, second)][None])
    delta_chi2s, ranks = _falls(kept, both)
    falls_lone, ranks_lone = _falls(kept, second)
    log_p = [0.0]
    if rank > rank_lone:
        log_p.append(float(log_tail(float(joint[0] - lone[0]) / dispersion, rank - rank_lone)))
    dof = int((ranks - ranks_lone).sum())
    if dof > 0:
        log_p.append(float(log_tail(float((delta_chi2s - falls_lone).sum()) / dispersion, dof)))
    return min(log_p) > np.log(alpha)


def still_needed(sizes: FloatArray, sds: FloatArray, weights: FloatArray, population: float, alpha: float) -> bool:
    """Whether fitted sizes (n,) with sd (n,) of one parameter are together distinguishable from none, as ``shared`` asks."""
    known = np.isfinite(sizes) & np.isfinite(sds) & (sds > 0.0)
    information = (1.0 / sds[known] ** 2)[:, None, None]
    evidence = Evidence((sizes[known] / sds[known] ** 2)[:, None], information, information, weights[known])
    return shared(evidence, [SharedTerm("it", (0,), (0,))], population, alpha).found is not None
