"""Forward selection: test the fit, add the best term, refit all parameters, test every term for removal, and repeat.

One budget of false alarms, ``Rules.alpha`` per family of candidates, decides every step:

1. A score must be significant at ``alpha`` among all candidates.
2. Its refit must lower chi2 as significantly, and the held-out data must agree (``refit_test`` has five reasons to refuse).
3. Of the accepted refits, the one with the smallest chi2 + 2 k is added (Akaike 1974; k parameters).  Candidates are refitted
   in the order of what their scores promise, until none promises ``settled_share`` of what the best refit has reached.
4. A term is removed when the fit without it is not worse at ``alpha``.
5. Where no single candidate is significant but structure is left, a pair that is significant at ``alpha`` is added.

Source: stepwise regression (Efroymson 1960).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from .fit_tests import (
    AT_LIMIT,
    FitTests,
    PairedDifference,
    Rules,
    fit_tests,
    held_out_difference,
    is_clear,
    log_p_without,
    refit_test,
)
from .pairs import best_pairs
from .problem import FitResult, Problem
from .scores import Score

Fits = Mapping[frozenset[str], FitResult]


class FitCache:
    """Makes each fit of a problem once.  It grows with use and is never part of a result; ``fits`` is a copy."""

    def __init__(self, problem: Problem, fits: Fits | None = None) -> None:
        self.problem = problem
        self._fits = dict(fits or {})

    def fit(self, terms: tuple[str, ...], start: FitResult | None = None) -> FitResult:
        """The fit with these terms; where it has not been made before, it starts from the parameters of ``start``."""
        key = frozenset(terms)
        if key not in self._fits:
            self._fits[key] = self.problem.fit(terms, start)
        return self._fits[key]

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
class ForwardSelection:
    """Course and end of a forward selection.

    Parameters
    ----------
    tests : of the first fit and of the fit after every pass; the last entry is the end.  Empty where the first fit failed.
    steps : terms added, in order.
    refused : term -> why it was not added although its score was significant.
    failed : why the first fit, or every fit with a term that was wanted first, failed.
    unfinished : term -> why its fit failed, although its score promises more than the misfit that is left at the end.
    fits : every fit made, by its terms; the first entry is the first fit.
    """

    tests: tuple[FitTests, ...]
    steps: tuple[SelectionStep, ...]
    refused: Mapping[str, str] = field(default_factory=dict)
    failed: str = ""
    unfinished: Mapping[str, str] = field(default_factory=dict)
    fits: Fits = field(default_factory=dict)

    @property
    def last(self) -> FitTests:
        """Tests of the last fit; only where the first fit succeeded."""
        return self.tests[-1]

    @property
    def added(self) -> tuple[str, ...]:
        """Added terms that are in the last model."""
        steps = {step.term for step in self.steps}
        return tuple(term for term in self.last.fit.terms if term in steps)


@dataclass(frozen=True, eq=False)
class _Pass:
    """The terms to add (none, one, or a pair), why others were refused or failed, and scores of those that ended at a limit."""

    steps: tuple[SelectionStep, ...]
    refused: Mapping[str, str] = field(default_factory=dict)
    failed: Mapping[str, str] = field(default_factory=dict)
    at_limit: Mapping[str, Score] = field(default_factory=dict)


def forward_selection(problem: Problem, terms: tuple[str, ...] = (), rules: Rules | None = None) -> ForwardSelection:
    """Add terms until no further one is justified; ``terms`` are in the first model and may be removed too."""
    rules = rules or Rules()
    cache = FitCache(problem)
    start = cache.fit(terms)
    if not start.ok:
        return ForwardSelection((), (), {}, start.why or "the baseline could not be fitted", fits=cache.fits)
    tests, failed = [fit_tests(problem, start, rules)], ""
    steps: list[SelectionStep] = []
    refused: dict[str, str] = {}
    unfinished: dict[str, str] = {}
    at_limit: dict[str, Score] = {}
    while len(steps) < rules.rungs:
        found = _next(cache, tests[-1], at_limit, frozenset(refused), rules)
        at_limit |= found.at_limit
        refused |= {**found.refused, **found.failed}
        if not found.steps:
            # After the first step a failure is no longer the outcome: the misfit that is left decides the verdict.
            if found.failed and not found.refused and not steps:
                failed = f"no fit with {', '.join(found.failed)} succeeded ({next(iter(found.failed.values()))})"
            promised = {score.name: score.delta_chi2 for score in tests[-1].scores}
            # chi2 of the noise scatters by sqrt(2 dof), and a score that expects the whole misfit by as much.
            left = tests[-1].fit.chi2 - tests[-1].fit.dof - 2.0 * np.sqrt(2.0 * tests[-1].fit.dof)
            unfinished = {name: why for name, why in found.failed.items() if promised[name] > left}
            break
        current, dropped = _prune(cache, found.steps[-1].fit, rules)
        steps += [*found.steps[:-1], replace(found.steps[-1], fit=current, dropped=dropped)]
        if any(frozenset(current.terms) == frozenset(old.fit.terms) for old in tests):
            break
        tests.append(fit_tests(problem, current, rules))
        if _to_be_corrected(tests[0], found.steps):
            break
    return ForwardSelection(tuple(tests), tuple(steps), refused, failed, unfinished, cache.fits)


def _to_be_corrected(first: FitTests, steps: Sequence[SelectionStep]) -> bool:
    """Whether the records must be corrected beside the curved term of ``steps`` before anything else can be judged.

    What is left beside it belongs to corrections that were made without it: a pole of 27 us was followed by two rungs of other
    effects, of which one refit took 73 s (bench-one 61, seed 2038).
    """
    return not first.signatures.beside and bool(first.signatures.curved & {step.term for step in steps})


def _next(
    cache: FitCache, tests: FitTests, at_limit: Mapping[str, Score], refused: frozenset[str], rules: Rules
) -> _Pass:
    """Refit the curved and the significant candidates; curved ones that were ``refused`` before only if nothing else is added.

    Where nothing is significant, the best pair is tried last.  ``at_limit`` holds the scores of terms whose refit ended at a
    limit; while their scan peaks at the same grid point it would do so again.
    """
    # A score knows the first order alone, so it says nothing about a candidate whose second order is all that is left, even
    # where it is significant: a pole of 82 us promised less than a feedthrough, and was not found (bench-one 39, seed 2039).
    curved = tests.curved(rules.alpha_left)
    # Refits of refused ones at every rung took 40 % of the time of a campaign with self-heating (bench-foreign 5, seed 2040).
    again = tuple(score for score in curved if score.name in refused)
    significant = tests.significant(rules.alpha)
    found = _refits(cache, tests, at_limit, tuple(score for score in curved if score not in again), significant, rules)
    if again and not found.steps:
        late = _refits(cache, tests, at_limit, again, (), rules)
        found = _Pass(late.steps, {**found.refused, **late.refused}, {**found.failed, **late.failed}, found.at_limit)
    return found if found.steps or significant else replace(found, steps=_pair(cache, tests, rules))


def _refits(
    cache: FitCache,
    tests: FitTests,
    at_limit: Mapping[str, Score],
    curved: Sequence[Score],
    significant: Sequence[Score],
    rules: Rules,
) -> _Pass:
    """Refit candidates, the most promising first, until none can be expected to exceed the best refit."""
    reasons: dict[str, str] = {}
    failed: dict[str, str] = {}
    limited: dict[str, Score] = {}
    accepted: list[tuple[float, int, SelectionStep]] = []
    reached = -np.inf
    promised = {score.name: _gain(tests.fit, score, score.delta_chi2) for score in significant}
    promised |= {score.name: np.inf for score in curved}
    wanted = (*curved, *(score for score in significant if score not in curved))
    for score in sorted(wanted, key=lambda score: promised[score.name], reverse=True):
        name = score.name
        if promised[name] < rules.settled_share * reached and not tests.is_coarse:
            break
        if name in at_limit and _same_point(score, at_limit[name]):
            reasons[name] = AT_LIMIT
            continue
        if score not in curved and score.delta_chi2 < rules.least_expected * tests.excess:
            reasons[name] = f"its expected decrease of chi2 is below {100 * rules.least_expected:.0f} % of the misfit"
            continue
        fit = cache.fit((*tests.fit.terms, name), tests.fit)
        test = refit_test(tests, score.parameters, fit, (name,), rules)
        gain = _gain(tests.fit, score, test.delta_chi2)
        if test.outcome == "failed":
            failed[name] = test.reason
        elif test.outcome != "accepted":
            reasons[name] = test.reason
            limited |= {name: score} if test.outcome == "at limit" else {}
        else:
            accepted.append((gain, score.parameters, SelectionStep(name, fit, test.delta_chi2, test.held)))
            reached = max(reached, gain)
    return _Pass(_best(cache.problem, tests, accepted, rules), reasons, failed, limited)


def _best(
    problem: Problem, tests: FitTests, accepted: Sequence[tuple[float, int, SelectionStep]], rules: Rules
) -> tuple[SelectionStep, ...]:
    """Of accepted refits (gain, parameters, step) the one that gains most; among equals, one that leaves no structure.

    The gain of a curved term is too small while the deviations of the records are linear: a pole of 27 us gained 2430, a
    feedthrough 2476.  So it equals the best from ``settled_share`` of it on, and comes first where all leave structure.
    """
    ranked = sorted(accepted, key=lambda one: one[0], reverse=True)
    new, best = tests.signatures.curved - tests.signatures.beside, ranked[0][0] if ranked else 0.0
    curved = [step for gain, _, step in ranked if step.term in new and gain >= rules.settled_share * best]
    equal = [step for gain, k, step in ranked if step in curved or tests.is_negligible(best - gain, k, rules.alpha)]
    for step in equal if len(equal) > 1 else ():
        if not fit_tests(problem, step.fit, rules).is_structured(rules.alpha_left):
            return (step,)
    return tuple(curved[:1]) or tuple(step for _, _, step in ranked[:1])


def _gain(fit: FitResult, score: Score, delta_chi2: float) -> float:
    """Decrease of chi2 [sigma^2] less 2 for each parameter (Akaike 1974), so that terms of different size compare."""
    variance = 1.0 if fit.noise_known else max(fit.chi2 / max(fit.dof, 1), 1e-300)
    return delta_chi2 / variance - 2.0 * score.parameters


def _same_point(now: Score, before: Score) -> bool:
    """Whether the scan of a term peaks at the same grid point; false for a term without a grid, which is always refitted."""
    points = [{name: value for name, (value, sd) in score.estimate.items() if np.isnan(sd)} for score in (now, before)]
    return bool(points[0]) and points[0] == points[1]


def _pair(cache: FitCache, tests: FitTests, rules: Rules) -> tuple[SelectionStep, ...]:
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


def _prune(cache: FitCache, fit: FitResult, rules: Rules) -> tuple[FitResult, tuple[str, ...]]:
    """Remove every term without which the fit is not significantly worse, the least significant first."""
    dropped: list[str] = []
    while len(fit.terms) > 1:
        worst: tuple[float, FitResult, str] | None = None
        for term in fit.terms[:-1] if not dropped else fit.terms:
            if is_clear(fit, term):
                continue
            smaller = cache.fit(tuple(name for name in fit.terms if name != term), fit)
            if not smaller.ok:
                continue
            log_p = log_p_without(fit, smaller)
            if log_p > np.log(rules.alpha) and (worst is None or log_p > worst[0]):
                worst = (log_p, smaller, term)
        if worst is None:
            break
        fit = worst[1]
        dropped.append(worst[2])
    return fit, tuple(dropped)
