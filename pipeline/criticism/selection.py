"""Forward selection: test the fit, add the best term, refit all parameters, test every term for removal, and repeat.

One budget of false alarms, ``Rules.alpha`` per family of candidates, decides every step:

1. A score must be significant at ``alpha`` among all candidates.
2. Its refit must lower chi2 as significantly, and the held-out data must agree (``refit_test`` has five reasons to refuse).
3. Of the accepted refits, the one with the smallest chi2 + 2 k is added (Akaike 1974; k parameters).  Candidates are refitted
   in the order of what their scores promise, until none promises what the best refit has reached (within ``same_promise``).
4. A term is removed when the fit without it is not worse at ``alpha``.
5. Where no single candidate is significant but structure is left, a pair that is significant at ``alpha`` is added.

Source: stepwise regression (Efroymson 1960).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from .fit_tests import FitTests, Rules, is_clear, log_p_without
from .problem import FitResult, Problem
from .rung import FitCache, Fits, Refusal, RungOutcome, SelectionStep, pair, refits


@dataclass(frozen=True, eq=False)
class ForwardSelection:
    """Course and end of a forward selection.

    Parameters
    ----------
    tests : of the first fit and of the fit after every pass; the last entry is the end.  Empty where the first fit failed.
    steps : terms added, in order.
    refused : term -> why it was not added although its score was significant.
    failed : why the first fit, or every fit with a term that was wanted first, failed.
    unfinished : term -> why its fit failed, although its score promises as much as the misfit that is left at the end (within
        ``same_promise``), and more than any term whose refit was judged.
    not_tried : terms that are significant at the end, but were never refitted because ``Rules.rungs`` terms were added.
    fits : every fit made, by its terms; the first entry is the first fit.
    """

    tests: tuple[FitTests, ...]
    steps: tuple[SelectionStep, ...]
    refused: Mapping[str, str] = field(default_factory=dict)
    failed: str = ""
    unfinished: Mapping[str, str] = field(default_factory=dict)
    not_tried: tuple[str, ...] = ()
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


def forward_selection(problem: Problem, terms: tuple[str, ...] = (), rules: Rules | None = None) -> ForwardSelection:
    """Add terms until no further one is justified; ``terms`` are in the first model and may be removed too."""
    rules = rules or Rules()
    cache = FitCache(problem)
    start = cache.fit(terms)
    if not start.ok:
        return ForwardSelection((), (), {}, start.why or "the baseline could not be fitted", fits=cache.fits)
    tests, failed = [cache.tests(start, rules)], ""
    steps: list[SelectionStep] = []
    refused: dict[str, str] = {}
    unfinished: dict[str, str] = {}
    refusals: dict[str, Refusal] = {}
    while len(steps) < rules.rungs or not tests[-1].fit.noise_known:
        found = _next(cache, tests[-1], refusals, frozenset(refused), rules)
        refusals |= found.refusals
        refused |= {**found.refused, **found.failed}
        if not found.steps:
            # After the first step a failure is no longer the outcome: the misfit that is left decides the verdict.
            if found.failed and not found.refused and not steps:
                failed = f"no fit with {', '.join(found.failed)} succeeded ({next(iter(found.failed.values()))})"
            promised = {score.name: score.delta_chi2 for score in tests[-1].scores}
            # chi2 of the noise scatters by sqrt(2 dof), and a score that expects the whole misfit by as much.
            excess = tests[-1].fit.chi2 - tests[-1].fit.dof - 2.0 * np.sqrt(2.0 * tests[-1].fit.dof)
            # A term that promises less than one whose refit was judged would not have explained more than that one.
            judged = max((promised.get(name, 0.0) for name in found.refused), default=0.0)
            enough = max((1.0 - rules.same_promise) * excess, judged)
            unfinished = {name: why for name, why in found.failed.items() if promised[name] > enough}
            break
        current, dropped = _prune(cache, found.steps[-1].fit, rules)
        steps += [*found.steps[:-1], replace(found.steps[-1], fit=current, dropped=dropped)]
        if any(frozenset(current.terms) == frozenset(old.fit.terms) for old in tests):
            break
        tests.append(cache.tests(current, rules))
        if _to_be_corrected(tests[0], found.steps):
            break
    complete = len(steps) >= rules.rungs and tests[-1].fit.noise_known
    left = tests[-1].significant(rules.alpha) if complete else ()
    not_tried = tuple(score.name for score in left if score.name not in refused)
    return ForwardSelection(tuple(tests), tuple(steps), refused, failed, unfinished, not_tried, cache.fits)


def _to_be_corrected(first: FitTests, steps: Sequence[SelectionStep]) -> bool:
    """Whether the records must be corrected beside the curved term of ``steps`` before anything else can be judged.

    What is left beside it belongs to corrections that were made without it: a pole of 27 us was followed by two rungs of other
    effects, of which one refit took 73 s (bench-one 61, seed 2038).
    """
    return not first.signatures.beside and bool(first.signatures.curved & {step.term for step in steps})


def _next(
    cache: FitCache, tests: FitTests, refusals: Mapping[str, Refusal], refused: frozenset[str], rules: Rules
) -> RungOutcome:
    """Refit the curved and the significant candidates; curved ones that were ``refused`` before only if nothing else is added.

    Where nothing is significant, the best pair is tried last.
    """
    # A score knows the first order alone, so it says nothing about a candidate whose second order is all that is left, even
    # where it is significant: a pole of 82 us promised less than a feedthrough, and was not found (bench-one 39, seed 2039).
    curved = tests.curved(rules.alpha_left)
    # Refits of refused ones at every rung took 40 % of the time of a campaign with self-heating (bench-foreign 5, seed 2040).
    again = tuple(score for score in curved if score.name in refused)
    significant = tests.significant(rules.alpha)
    found = refits(cache, tests, refusals, tuple(score for score in curved if score not in again), significant, rules)
    # Beside a preload, four that had gained 3 to 369 of 84,000 took 155 s in vain (bench-foreign 1, seed 2048).
    hopeless = {name for name, refusal in refusals.items() if refusal.is_hopeless(tests, rules)}
    again = tuple(score for score in again if score.name not in hopeless)
    if again and not found.steps:
        late = refits(cache, tests, refusals, again, (), rules)
        found = RungOutcome(
            late.steps, {**found.refused, **late.refused}, {**found.failed, **late.failed}, found.refusals
        )
    return found if found.steps or significant else replace(found, steps=pair(cache, tests, rules))


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
