"""One look at one fit: the scores of what is absent, the structure that is left, and what could not have been seen."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

from .goodness import ResidualTests, goodness
from .problem import FitResult, Problem, Region, Signatures
from .projection import Baseline, Projected, baseline, project
from .scores import Score
from .significance import DRAWS, Null, score_all


@dataclass(frozen=True)
class Rules:
    """The rules of the loop.

    Parameters
    ----------
    alpha : family-wise probability of naming a term where there is none.
    alpha_left : probability of calling a residual structured where it is noise: "unknown", a milder fault than a wrong name.
    rungs : how many terms may be added.
    least : a term must take this share of the misfit, or what is missing is something else.
    promise : a score must promise this share of it to be worth a refit.
    together : how many terms a diagnosis may name together.
    contenders : how many significant candidates are refitted before one is chosen.
    near : a contender promises at least this share of the largest fall of chi2;
    kept : and of the fall that a refit brought, where that was at least this share of its own promise.
    class_refits : how many rivals of a term are refitted in its place.
    draws, seed : of the simulated nulls.
    """

    alpha: float = 0.003
    alpha_left: float = 0.01
    rungs: int = 6
    least: float = 0.15
    promise: float = 0.01
    together: int = 3
    contenders: int = 3
    near: float = 0.5
    kept: float = 0.8
    class_refits: int = 4
    draws: int = DRAWS
    seed: int = 0


@dataclass(frozen=True, eq=False)
class FitTests:
    """What one fit shows.

    ``base`` its columns, orthonormal; ``scores`` most significant first; ``null`` they were judged by; ``projected`` the scores'
    covariance; ``goodness`` of what is left; ``regions`` its energy; ``invisible`` the candidates that these data could not have
    shown.
    """

    fit: FitResult
    base: Baseline
    signatures: Signatures
    projected: Projected
    scores: tuple[Score, ...]
    null: Null
    goodness: ResidualTests
    regions: tuple[Region, ...]

    @property
    def invisible(self) -> tuple[str, ...]:
        """Terms that these data could not have shown, however strong within their range."""
        return tuple(sorted(score.name for score in self.scores if not score.detectable))

    def significant(self, alpha: float) -> tuple[Score, ...]:
        """Candidates that are significant, family-wise."""
        return tuple(score for score in self.scores if score.p_value < alpha)


def fit_tests(problem: Problem, fit: FitResult, rules: Rules) -> FitTests:
    """Examine a fit that is ok."""
    base = baseline(fit)
    with ThreadPoolExecutor(1) as pool:
        # What is left does not ask what could explain it.
        rest = pool.submit(_left, problem, fit, base)
        signatures = problem.signatures(fit)
        projected = project(base, signatures.blocks, signatures.grams)
        scores, null = score_all(
            projected, signatures.candidates, fit.noise_known, rules.draws, rules.seed, signatures.local
        )
        regions, left = rest.result()
    return FitTests(fit, base, signatures, projected, scores, null, left, regions)


def _left(problem: Problem, fit: FitResult, base: Baseline) -> tuple[tuple[Region, ...], ResidualTests]:
    regions = tuple(problem.regions(fit))
    return regions, goodness(fit, base, problem.probes(fit), regions, problem.spectrum(fit))
