"""How often noise alone makes a score as large as the largest of all candidates.

    null:          s* = L e,  L L' = S,  e ~ N(0, 1)
    candidate i:   U_i = max over its cells of T / inflation,   p_i = 1 - (1 - P(chi2_k > U_i))^N_i
    family:        p   = P(min_i p_i* <= p_i)

N_i, the effective number of independent trials of a scan (one half at a boundary), is set at the 99 % quantile of U_i*; what
remains of the approximation is taken out by simulating min p itself.  Beyond the simulation the family's own effective
number of trials extrapolates.  With an unknown noise level chi2 becomes F, and the residual sum of squares is drawn too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from .problem import Candidate, LocalCandidate
from .projection import Projected
from .scores import Cell, Score, cells_of, delta_chi2s, estimate, visibility
from .tails import log_any, log_tail, trials_of

DRAWS = 20_000
#: An SNR that would be found nine times in ten at the default significance.
WORTH = 5.0
_CALIBRATED = 0.01
#: Draws at a time: what is made of them stays in the processor's cache.
_CHUNK = 1000
_SURE = 20


@dataclass(frozen=True, eq=False)
class Null:
    """The simulated null of a set of candidates.

    ``trials`` (I,) of each candidate; ``smallest`` the sorted log of min p; ``known`` is false where F replaces chi2.
    """

    trials: FloatArray
    smallest: FloatArray
    known: bool

    def p_family(self, log_p: float) -> float:
        """P(min p* <= p)."""
        below = int(np.searchsorted(self.smallest, log_p, side="right"))
        if below >= _SURE:
            return (below + 1) / (self.smallest.size + 1)
        share = _SURE / self.smallest.size
        return float(np.exp(log_any(log_p, trials_of(float(self.smallest[_SURE]), share))))

    def critical(self, alpha: float) -> float:
        """The log p of a single candidate that is significant at ``alpha``, family-wise."""
        place = alpha * self.smallest.size
        if place >= _SURE:
            return float(self.smallest[int(place)])
        trials = trials_of(float(self.smallest[_SURE]), _SURE / self.smallest.size)
        return float(np.log(-np.expm1(np.log1p(-alpha) / trials)))


def simulate_null(
    projected: Projected,
    candidates: Sequence[Candidate],
    cells: Sequence[Sequence[Cell]],
    known: bool = True,
    draws: int = DRAWS,
    seed: int = 0,
    local: Sequence[LocalCandidate] = (),
) -> Null:
    """Draw the null of the scores of some candidates.

    Parameters
    ----------
    projected : their scores' covariance.
    candidates, cells : I of each, see ``cells_of``.
    known : the noise level is known.
    draws, seed : of the simulation.
    local : candidates with free amplitudes in every block; one cell each, independent of all others.
    """
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(0x5C07E,)))
    size, vector = np.linalg.eigh(projected.covariance)
    good = size > 1e-13 * max(float(size[-1]), 1e-300) if size.size else np.zeros(0, dtype=bool)
    root = vector[:, good] * np.sqrt(size[good])
    log_p = np.zeros((len(candidates) + len(local), draws))
    trials = np.ones(len(candidates))
    for first in range(0, draws, _CHUNK):
        part = slice(first, min(first + _CHUNK, draws))
        normal = rng.standard_normal((root.shape[1], part.stop - first))
        scores = root @ normal
        rest: FloatArray | None = None
        if not known:
            spare = max(projected.dof - root.shape[1], 0) or 1e-9
            rest = np.sum(normal**2, axis=0) + rng.chisquare(spare, normal.shape[1])
        for i, own in enumerate(cells):
            log_p[i, part] = _log_single(projected, own, scores, rest)
    for i, candidate in enumerate(candidates):
        if len(candidate.cells) > 1 or any(parameter.side for parameter in candidate.parameters):
            trials[i] = trials_of(float(np.quantile(log_p[i], _CALIBRATED)), _CALIBRATED)
            log_p[i] = log_any(log_p[i], trials[i])
    for i, other in enumerate(local, len(candidates)):
        # The smallest of several uniform numbers.
        log_p[i] = np.log(-np.expm1(np.log1p(-rng.random(draws)) / len(other.delta_chi2s)))
        log_p[i] = log_any(log_p[i], len(other.delta_chi2s))
    smallest = np.sort(log_p.min(axis=0)) if len(log_p) else np.zeros(draws)
    return Null(trials, smallest, known)


def _log_single(projected: Projected, cells: Sequence[Cell], scores: FloatArray, rest: FloatArray | None) -> FloatArray:
    """log p of one trial (n,) of the best cell for scores (K, n); ``rest`` (n,) sums of squares where F is meant."""
    rank = max((cell.rank for cell in cells), default=0)
    best = np.zeros(scores.shape[1])
    for cell in cells:
        best = np.maximum(best, delta_chi2s(cell, scores)[0] / cell.inflation)
    if rank == 0:
        return np.zeros_like(best)
    if rest is None:
        return log_tail(best, rank)
    left = projected.dof - rank
    if left <= 0:
        return np.zeros_like(best)
    ratio = best * left / np.maximum(rest - best, 1e-300)
    return log_tail(ratio, rank, left)


def score_all(
    projected: Projected,
    candidates: Sequence[Candidate],
    known: bool = True,
    draws: int = DRAWS,
    seed: int = 0,
    local: Sequence[LocalCandidate] = (),
) -> tuple[tuple[Score, ...], Null]:
    """Score every candidate, most significant first, and the null they were judged by."""
    cells = [cells_of(projected, candidate) for candidate in candidates]
    null = simulate_null(projected, candidates, cells, known, draws, seed, local)
    rest = None if known else np.array([projected.chi2])
    scores = []
    for i, (candidate, own) in enumerate(zip(candidates, cells)):
        single = _log_single(projected, own, projected.score[:, None], rest)
        log_p = float(log_any(single, null.trials[i])[0])
        best, values = estimate(projected, candidate, own)
        fall = float(delta_chi2s(own[best], projected.score[:, None])[0][0])
        share, snr = visibility(projected, candidate, own)
        if not known:
            snr /= max(np.sqrt(projected.chi2 / max(projected.dof, 1)), 1e-300)
            level = np.sqrt(max(projected.chi2 - fall, 0.0) / max(projected.dof - len(candidate.parameters), 1))
            values = {name: (value, float(sd * level)) for name, (value, sd) in values.items()}
        scores.append(
            Score(
                candidate.name,
                fall,
                len(candidate.parameters) + len(candidate.grid[best]),
                values,
                log_p,
                null.p_family(log_p),
                share,
                snr,
                snr >= WORTH,
            )
        )
    for other in local:
        # Where no noise level is known, the residual's own is all there is.
        level = 1.0 if known else max(projected.chi2 / max(projected.dof, 1), 1e-300)
        levels = other.levels or (1.0,) * len(other.delta_chi2s)
        singles = [float(log_tail(f / (level * g), dof)) for f, g, dof in zip(other.delta_chi2s, levels, other.dofs)]
        best = max(range(len(singles)), key=lambda i: (-singles[i], other.delta_chi2s[i]))
        log_p = float(log_any(singles[best], len(singles)))
        values = {name: (value, float("nan")) for name, value in other.grid[best].items()}
        p_value, snr = null.p_family(log_p), float(np.sqrt(other.reach))
        fall, dof = other.delta_chi2s[best], other.dofs[best]
        scores.append(Score(other.name, fall, dof, values, log_p, p_value, 1.0, snr, snr >= WORTH))
    return tuple(sorted(scores, key=lambda score: (score.log_p_single, -score.delta_chi2))), null
