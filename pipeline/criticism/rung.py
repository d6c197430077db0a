"""One rung of the forward selection: refit candidates in the order of what they promise, and choose one, or a pair.

Promise and gain are delta chi2 - 2 k (Akaike 1974; k parameters) of the score and of the refit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from .fit_tests import (
    FitTests,
    RefitTest,
    Rules,
    fit_tests,
    refit_test,
)
from .held_out import PairedDifference, held_out_difference
from .pairs import best_pairs
from .problem import FitResult, Problem
from .scores import Score
from .significance import log_tail

Fits = Mapping[frozenset[str], FitResult]


class FitCache:
    """Makes each fit of a problem, and its tests, once.  It grows with use and is never part of a result; ``fits`` is a copy."""

    def __init__(self, problem: Problem, fits: Fits | None = None) -> None:
        self.problem = problem
        self._fits = dict(fits or {})
        self._tests: dict[tuple[frozenset[str], Rules], FitTests] = {}

    def fit(self, terms: tuple[str, ...], start: FitResult | None = None) -> FitResult:
        """The fit with these terms; where it has not been made before, it starts from the parameters of ``start``."""
        key = frozenset(terms)
        if key not in self._fits:
            self._fits[key] = self.problem.fit(terms, start)
        return self._fits[key]

    def tests(self, fit: FitResult, rules: Rules) -> FitTests:
        """``fit_tests`` of a fit of this problem."""
        key = frozenset(fit.terms), rules
        if key not in self._tests:
            self._tests[key] = fit_tests(self.problem, fit, rules)
        return self._tests[key]

    @property
    def fits(self) -> Fits:
        """All fits made so far, by their terms."""
        return dict(self._fits)


@dataclass(frozen=True, eq=False)
class SelectionStep:
    """One term added.

    Parameters
    ----------
    term : the term.
    fit : with the term in the model.
    delta_chi2 : decrease of chi2 on the fitted data.
    held : decrease of chi2 on the held-out data, and its sd.
    dropped : terms removed afterwards.
    alone : the term was significant by itself, not only as one of a pair.
    """

    term: str
    fit: FitResult
    delta_chi2: float
    held: PairedDifference
    dropped: tuple[str, ...] = ()
    alone: bool = True


@dataclass(frozen=True, eq=False)
class Refusal:
    """A term that was refitted and not accepted: its ``score`` then, and the ``test`` of the refit."""

    score: Score
    test: RefitTest

    def stays(self, score: Score, tests: FitTests, rules: Rules) -> bool:
        """Whether the term, with its present ``score``, would be refused again at the fit of ``tests``.

        Its refit leads to the same point while its scan peaks at the same grid point (at a limit), or while it promises
        what it did (within ``rules.same_promise``).
        """
        if self.test.outcome == "at limit":
            return _same_point(score, self.score)
        too_little = self.test.delta_chi2 < rules.least_share * tests.excess
        return (self.test.outcome != "little" or too_little) and _same_promise(score, self.score, rules)

    def is_hopeless(self, tests: FitTests, rules: Rules) -> bool:
        """Whether a refit at the fit of ``tests`` would explain too little, though it gained twice what it gained before.

        A curved term has no other promise than its last refit; terms without a scan gained at most 2.1 times what was
        expected of them (docs/explanation/selection.md).
        """
        return self.test.outcome != "at limit" and 2.0 * self.test.delta_chi2 < rules.least_share * tests.excess


@dataclass(frozen=True, eq=False)
class RungOutcome:
    """The terms to add (none, one, or a pair), why others were refused or failed, and their refits."""

    steps: tuple[SelectionStep, ...]
    refused: Mapping[str, str] = field(default_factory=dict)
    failed: Mapping[str, str] = field(default_factory=dict)
    refusals: Mapping[str, Refusal] = field(default_factory=dict)


def refits(
    cache: FitCache,
    tests: FitTests,
    before: Mapping[str, Refusal],
    curved: Sequence[Score],
    significant: Sequence[Score],
    rules: Rules,
) -> RungOutcome:
    """Refit candidates, the most promising first, until none can be expected to exceed the best refit, or one leaves nothing.

    Those that were refused ``before`` and would be again are left out.
    """
    reasons: dict[str, str] = {}
    failed: dict[str, str] = {}
    refusals: dict[str, Refusal] = {}
    accepted: list[tuple[float, int, SelectionStep]] = []
    reached, explained = -np.inf, False
    promised = {score.name: _gain(tests.fit, score, score.delta_chi2) for score in significant}
    promised |= {score.name: np.inf for score in curved}
    wanted = (*curved, *(score for score in significant if score not in curved))
    for score in sorted(wanted, key=lambda score: promised[score.name], reverse=True):
        name = score.name
        # Projection does not see a curved candidate, so each of them is refitted.
        if explained and score not in curved:
            break
        if promised[name] < (1.0 - rules.same_promise) * reached and not tests.is_coarse:
            break
        if name in before and score not in curved and before[name].stays(score, tests, rules):
            reasons[name] = before[name].test.reason
            continue
        least = rules.least_expected * (1.0 if _point(score) else 2.0)
        if score not in curved and score.delta_chi2 < least * tests.excess and not tests.is_coarse:
            reasons[name] = f"its expected decrease of chi2 is below {100 * least:.0f} % of the misfit"
            continue
        fit = cache.fit((*tests.fit.terms, name), tests.fit)
        test = refit_test(tests, score.parameters, fit, (name,), rules)
        gain = _gain(tests.fit, score, test.delta_chi2)
        if test.outcome == "failed":
            failed[name] = test.reason
        elif test.outcome != "accepted":
            reasons[name] = test.reason
            refusals[name] = Refusal(score, test)
        else:
            accepted.append((gain, score.parameters, SelectionStep(name, fit, test.delta_chi2, test.held)))
            reached = max(reached, gain)
            explained = explained or (gain == reached and _leaves_nothing(cache, fit, rules))
    return RungOutcome(_best(cache, tests, accepted, rules), reasons, failed, refusals)


def _leaves_nothing(cache: FitCache, fit: FitResult, rules: Rules) -> bool:
    """Whether neither structure nor a significant absent term is left, so that other terms can equal ``fit`` but not exceed it.

    Those that can equal it are found by projection and refitted for its class (``verdict``).  Beside a cubic stiffness at SNR
    185, refits of three others took 22 of 29 s (docs/explanation/selection.md).
    """
    # A level that is measured from the residual grows with what is left.
    if not fit.noise_known or fit.misfit or log_tail(fit.chi2, fit.dof) < np.log(rules.alpha_left):
        return False
    left = cache.tests(fit, rules)
    return not left.is_structured(rules.alpha_left) and not left.significant(rules.alpha)


def _best(
    cache: FitCache, tests: FitTests, accepted: Sequence[tuple[float, int, SelectionStep]], rules: Rules
) -> tuple[SelectionStep, ...]:
    """Of accepted refits (gain, parameters, step) the one that gains most; among equals, one that leaves no structure.

    The gain of a curved term is too small while the deviations of the records are linear: a pole of 27 us gained 2430, a
    feedthrough 2476.  So it equals the best where it gains the same within ``same_promise``; it comes first where all leave
    structure.
    """
    ranked = sorted(accepted, key=lambda one: one[0], reverse=True)
    new, best = tests.signatures.curved - tests.signatures.beside, ranked[0][0] if ranked else 0.0
    curved = [step for gain, _, step in ranked if step.term in new and gain >= (1.0 - rules.same_promise) * best]
    equal = [step for gain, k, step in ranked if step in curved or tests.is_negligible(best - gain, k, rules.alpha)]
    for step in equal if len(equal) > 1 else ():
        if not cache.tests(step.fit, rules).is_structured(rules.alpha_left):
            return (step,)
    return tuple(curved[:1]) or tuple(step for _, _, step in ranked[:1])


def _gain(fit: FitResult, score: Score, delta_chi2: float) -> float:
    """Decrease of chi2 [sigma^2] less 2 for each parameter (Akaike 1974), so that terms of different size compare."""
    variance = 1.0 if fit.noise_known else max(fit.chi2 / max(fit.dof, 1), 1e-300)
    return delta_chi2 / variance - 2.0 * score.parameters


def _point(score: Score) -> dict[str, float]:
    """Where the scan of a term peaks, by parameter; empty for a term without a grid."""
    return {name: value for name, (value, sd) in score.estimate.items() if np.isnan(sd)}


def _same_point(now: Score, before: Score) -> bool:
    """Whether the scan of a term peaks at the same grid point; false for a term without a grid, which is always refitted."""
    return bool(_point(now)) and _point(now) == _point(before)


def _same_promise(now: Score, before: Score, rules: Rules) -> bool:
    """Whether two scores of a term promise the same decrease of chi2."""
    return abs(now.delta_chi2 - before.delta_chi2) <= rules.same_promise * before.delta_chi2


def pair(cache: FitCache, tests: FitTests, rules: Rules) -> tuple[SelectionStep, ...]:
    """The most significant pair, where structure is left (or the noise level is unknown) and no single term is significant."""
    fit = tests.fit
    if fit.noise_known and tests.goodness.p_value >= rules.alpha_left:
        return ()
    pairs = best_pairs(tests.projected, tests.signatures.candidates, fit.noise_known, seed=rules.seed)
    if not pairs or pairs[0].p_value >= rules.alpha:
        return ()
    scores = {score.name: score for score in tests.scores}
    first, second = sorted(pairs[0].names, key=lambda name: -scores[name].delta_chi2)
    one = cache.fit((*fit.terms, first), fit)
    both = cache.fit((*fit.terms, first, second), one if one.ok else fit)
    test = refit_test(tests, scores[first].parameters + scores[second].parameters, both, (first, second), rules)
    if not one.ok or test.outcome != "accepted":
        return ()
    return (
        SelectionStep(first, one, fit.chi2 - one.chi2, held_out_difference(fit, one), alone=False),
        SelectionStep(second, both, one.chi2 - both.chi2, held_out_difference(one, both), alone=False),
    )
