"""p-values: tails in logarithms, the simulated null of the largest score, and the significance of every candidate.

    chi2_k(t), h = t/2,  even k:  P = e^-h sum_{i < k/2} h^i / i!
                         odd k:   P = erfc(sqrt h) + e^-h sum_{1 <= i <= (k-1)/2} h^(i - 1/2) / Gamma(i + 1/2)
                         large k: log P = -h + (k/2 - 1) log h - log Gamma(k/2) + log(1 + (k/2 - 1)/h + ...)
    F(k, nu):            P = I_x(nu/2, k/2),  x = nu / (nu + k f)
    N trials:            P_N = 1 - (1 - P)^N

    null:          s* = L e,  L L' = S,  e ~ N(0, 1)
    candidate i:   U_i = max over its cells of T / inflation,   p_i = 1 - (1 - P(chi2_k > U_i))^N_i
    family:        p   = P(min_i p_i* <= p_i)

N_i, the effective number of independent trials of a scan (one half at a boundary), is set at the quantile 1 - ALPHA of U_i*.
Simulating min p removes the remaining error of this approximation.  Beyond the simulated range, p is extrapolated with the
effective number of trials of the family.  With an unknown noise level chi2 becomes F, and the residual sum of squares is
simulated too.

S holds the noise level observed in each stratum, so noise that is stronger or coloured is no evidence for a term.  A true
effect loses almost nothing: its energy T is spread over n = 10^5 rows, and T / (1 + T/n) is as improbable as T.

Shapes: K columns in all, k of a candidate.  Sources: tails, Abramowitz and Stegun 26.4.4, 26.4.5, 6.5.32 and 26.6.2; effective
number of trials, Gross and Vitells 2010.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import betainc, betaln, erfcx, gamma, gammaincc, gammaln, log_ndtr

from ..arrays import FloatArray
from .budget import ALPHA, COUNTED, DETECTABLE_SNR, DRAWS
from .problem import Candidate, LocalCandidate
from .scores import ABSORBED, Cell, Projected, Score, cells_of, delta_chi2s, inverse_of, largest_delta_chi2s

#: Draws at a time, so that intermediate results stay in the processor's cache.
_CHUNK = 1000
#: Logarithm of the largest number; below the smallest one with a full mantissa the plain tail functions lose accuracy.
_LOG_LARGEST = float(np.log(np.finfo(float).max))
_TINY = float(np.finfo(float).tiny / np.finfo(float).eps)


def log_tail(statistic: FloatArray | float, k: int, dof: int | None = None) -> FloatArray:
    """log P of a statistic (...) that is chi2_k, or k F(k, dof) where ``dof`` is given; also where P underflows."""
    t = np.maximum(np.asarray(statistic, dtype=np.float64), 0.0)
    if dof is None and k > 0 and k / 2.0 * np.log1p(t.max(initial=0.0)) < _LOG_LARGEST:
        # No power of t overflows: the closed form is exact at any distance.
        return _log_chi2(t, k)
    plain = gammaincc(k / 2.0, t / 2.0) if dof is None else betainc(dof / 2.0, k / 2.0, dof / (dof + t))
    near = np.log(np.maximum(plain, _TINY))
    if np.all(plain > _TINY):
        return np.asarray(near)
    far = _log_chi2_far(np.maximum(t, 1.0), k) if dof is None else _log_f_far(t, k, dof)
    return np.asarray(np.where(plain > _TINY, near, np.minimum(far, np.log(_TINY))))


def _log_chi2(t: FloatArray, k: int) -> FloatArray:
    half = t / 2.0
    if k % 2 == 0:
        total = np.ones_like(half)
        for i in range(k // 2 - 1, 0, -1):
            total = 1.0 + total * half / i
        return np.asarray(-half + np.log(total))
    root = np.sqrt(half)
    total = np.zeros_like(half)
    for i in range((k - 1) // 2, 0, -1):
        total = total * half + 1.0 / gamma(i + 0.5)
    return np.asarray(-half + np.log(erfcx(root) + total * root))


def _log_f_far(t: FloatArray, k: int, dof: int) -> FloatArray:
    x = dof / (dof + t)
    start = dof / 2.0 * np.log(x) + (k / 2.0 - 1.0) * np.log1p(-np.minimum(x, 0.5))
    return np.asarray(start - np.log(dof / 2.0) - betaln(dof / 2.0, k / 2.0))


def _log_chi2_far(t: FloatArray, k: int) -> FloatArray:
    half, a = t / 2.0, k / 2.0
    # Two terms of the asymptotic series, so that statistics of different k stay comparable.
    series = 1.0 + (a - 1.0) / half + (a - 1.0) * (a - 2.0) / half**2
    return np.asarray(-half + (a - 1.0) * np.log(half) - gammaln(a) + np.log(np.maximum(series, 1e-3)))


def log_any(log_p: FloatArray | float, trials: FloatArray | float) -> FloatArray:
    """log(1 - (1 - p)^trials), that any of ``trials`` independent tests (a real number) falls below p; (...) like p."""
    log_p = np.asarray(log_p, dtype=np.float64)
    p = np.exp(np.minimum(log_p, -1e-16))
    with np.errstate(divide="ignore"):
        exact = np.log(np.maximum(-np.expm1(trials * np.log1p(-p)), 1e-300))
    return np.asarray(np.where(log_p < -25.0, np.minimum(log_p + np.log(trials), 0.0), exact))


def trials_of(log_p: float, share: float) -> float:
    """N for which the quantile at ``share`` of the smallest of N tests is p:  log(1 - share) / log(1 - p)."""
    return float(np.log1p(-share) / np.log1p(-np.exp(min(log_p, -1e-12))))


def normal_log_tail(z: FloatArray | float) -> FloatArray:
    """log P(|N(0, 1)| > |z|) of z (...) [sigma]."""
    return np.asarray(np.log(2.0) + log_ndtr(-np.abs(z)))


@dataclass(frozen=True, eq=False)
class Null:
    """The simulated null of a set of I candidates.

    Parameters
    ----------
    trials : (I,) effective number of independent trials of each.
    smallest : (draws,) log of the smallest p of each draw, sorted.
    known : false where the noise level is unknown and F replaces chi2.
    """

    trials: FloatArray
    smallest: FloatArray
    known: bool

    def p_family(self, log_p: float) -> float:
        """P(min_i p_i* <= p) from log p; beyond the simulated range by the effective number of trials."""
        below = int(np.searchsorted(self.smallest, log_p, side="right"))
        if below >= COUNTED:
            return (below + 1) / (self.smallest.size + 1)
        share = COUNTED / self.smallest.size
        return float(np.exp(log_any(log_p, trials_of(float(self.smallest[COUNTED]), share))))

    def critical(self, alpha: float) -> float:
        """The log p of a single candidate at which ``p_family`` is ``alpha``."""
        place = alpha * self.smallest.size
        if place >= COUNTED:
            return float(self.smallest[int(place)])
        trials = trials_of(float(self.smallest[COUNTED]), COUNTED / self.smallest.size)
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
    """Simulate the scores of candidates where none of them is present.

    Parameters
    ----------
    projected : supplies the covariance of the scores.
    candidates, cells : I candidates and the ``cells_of`` each.
    known : the noise level is known.
    draws, seed : of the simulation.
    local : candidates with free amplitudes in every block; independent of all others.
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
        total: FloatArray | None = None
        if not known:
            spare = max(projected.dof - root.shape[1], 0) or 1e-9
            total = np.sum(normal**2, axis=0) + rng.chisquare(spare, normal.shape[1])
        for i, own in enumerate(cells):
            log_p[i, part] = _log_single(projected, own, scores, total)
    for i, candidate in enumerate(candidates):
        if len(candidate.cells) > 1 or any(parameter.side for parameter in candidate.parameters):
            trials[i] = trials_of(float(np.quantile(log_p[i], ALPHA)), ALPHA)
            log_p[i] = log_any(log_p[i], trials[i])
    for i, other in enumerate(local, len(candidates)):
        # The smallest of several uniform numbers.
        log_p[i] = np.log(-np.expm1(np.log1p(-rng.random(draws)) / len(other.delta_chi2s)))
        log_p[i] = log_any(log_p[i], len(other.delta_chi2s))
    smallest = np.sort(log_p.min(axis=0)) if len(log_p) else np.zeros(draws)
    return Null(trials, smallest, known)


def _log_single(
    projected: Projected, cells: Sequence[Cell], scores: FloatArray, total: FloatArray | None
) -> FloatArray:
    """log p (n,) of the best cell for scores (K, n) in one trial; ``total`` (n,) sums of squares where F is meant."""
    rank = max((cell.rank for cell in cells), default=0)
    best = np.zeros(scores.shape[1])
    for cell in cells:
        best = np.maximum(best, largest_delta_chi2s(cell, scores) / cell.inflation)
    if rank == 0:
        return np.zeros_like(best)
    if total is None:
        return log_tail(best, rank)
    dof = projected.dof - rank
    if dof <= 0:
        return np.zeros_like(best)
    ratio = best * dof / np.maximum(total - best, 1e-300)
    return log_tail(ratio, rank, dof)


def score_all(
    projected: Projected,
    candidates: Sequence[Candidate],
    known: bool = True,
    draws: int = DRAWS,
    seed: int = 0,
    local: Sequence[LocalCandidate] = (),
) -> tuple[tuple[Score, ...], Null]:
    """Score every candidate, most significant first, with the null that gave the p-values; arguments as ``simulate_null``."""
    cells = [cells_of(projected, candidate) for candidate in candidates]
    null = simulate_null(projected, candidates, cells, known, draws, seed, local)
    scores = [
        *(_score(projected, candidate, own, null, i) for i, (candidate, own) in enumerate(zip(candidates, cells))),
        *(_score_local(projected, other, null) for other in local),
    ]
    return tuple(sorted(scores, key=lambda score: (score.log_p_single, -score.delta_chi2))), null


def _score(projected: Projected, candidate: Candidate, cells: Sequence[Cell], null: Null, place: int) -> Score:
    """The score of the candidate that is at ``place`` in ``null``."""
    total = None if null.known else np.array([projected.chi2])
    single = _log_single(projected, cells, projected.score[:, None], total)
    log_p = float(log_any(single, null.trials[place])[0])
    best, delta_chi2, values = _estimate(projected, candidate, cells)
    share, snr = _visibility(projected, candidate, cells)
    if not null.known:
        snr /= max(np.sqrt(projected.chi2 / max(projected.dof, 1)), 1e-300)
        level = np.sqrt(max(projected.chi2 - delta_chi2, 0.0) / max(projected.dof - len(candidate.parameters), 1))
        values = {name: (value, float(sd * level)) for name, (value, sd) in values.items()}
    parameters = len(candidate.parameters) + len(candidate.grid[best])
    p_value, detectable = null.p_family(log_p), snr >= DETECTABLE_SNR
    return Score(candidate.name, delta_chi2, parameters, values, log_p, p_value, share, snr, detectable)


def _score_local(projected: Projected, other: LocalCandidate, null: Null) -> Score:
    # An unknown noise level is estimated from the residual.
    level = 1.0 if null.known else max(projected.chi2 / max(projected.dof, 1), 1e-300)
    levels = other.levels or (1.0,) * len(other.delta_chi2s)
    # A line above Nyquist has neither energy nor a level.
    scaled = [f / max(level * g, 1e-300) for f, g in zip(other.delta_chi2s, levels)]
    singles = [float(log_tail(f, dof)) for f, dof in zip(scaled, other.dofs)]
    best = max(range(len(singles)), key=lambda i: (-singles[i], other.delta_chi2s[i]))
    log_p = float(log_any(singles[best], len(singles)))
    values = {name: (value, float("nan")) for name, value in other.grid[best].items()}
    p_value, snr = null.p_family(log_p), float(np.sqrt(other.reach))
    delta_chi2, dof = other.delta_chi2s[best], other.dofs[best]
    return Score(other.name, delta_chi2, dof, values, log_p, p_value, 1.0, snr, snr >= DETECTABLE_SNR)


def _estimate(
    projected: Projected, candidate: Candidate, cells: Sequence[Cell]
) -> tuple[int, float, Mapping[str, tuple[float, float]]]:
    """The best cell, its T, and parameter -> (null + theta, sd) there, in the parameters' own units."""
    every = [delta_chi2s(cell, projected.score[:, None]) for cell in cells]
    best = int(np.argmax([decrease[0] for decrease, _ in every]))
    cell = cells[best]
    inverse, _ = inverse_of(projected.gram[np.ix_(cell.columns, cell.columns)])
    covariance = inverse @ projected.covariance[np.ix_(cell.columns, cell.columns)] @ inverse
    sd = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    norms = np.where(projected.norms[cell.columns] > 0.0, projected.norms[cell.columns], np.inf)
    values = {
        parameter.name: (parameter.null + float(theta / norm), float(s / norm) if s > 0.0 else float("nan"))
        for parameter, theta, s, norm in zip(candidate.parameters, every[best][1][:, 0], sd, norms)
    }
    values.update({name: (value, float("nan")) for name, value in candidate.grid[best].items()})
    return best, float(every[best][0][0]), values


def _visibility(projected: Projected, candidate: Candidate, cells: Sequence[Cell]) -> tuple[float, float]:
    """Surviving share, and SNR at the end of the declared range, of the most visible parameter over all cells."""
    share, snr = 0.0, 0.0
    for cell in cells:
        left = np.sqrt(np.maximum(np.diag(projected.gram)[cell.columns], 0.0))
        spread = np.sqrt(np.maximum(np.diag(projected.covariance)[cell.columns], 1e-300))
        reach = np.array([parameter.reach for parameter in candidate.parameters])
        visible = left > ABSORBED
        if not visible.any():
            continue
        share = max(share, float(left.max()))
        # The sd of a single parameter is sqrt(S)/G, so its SNR is reach norm G / sqrt(S).
        snr = max(snr, float(np.max((reach * projected.norms[cell.columns] * left**2 / spread)[visible])))
    return share, snr
