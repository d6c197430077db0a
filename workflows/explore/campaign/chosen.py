"""Effects that a user chose, in the order of choice: the same fits, tests and rungs as of ``refine``, without its search.

    refine      the best of the significant effects is added, until none is left
    chosen      the next one of the list is added, whatever its score

So a list that holds the effects of ``refine`` in its order has the same fits, and the same errors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from pipeline.criticism.fit_tests import RefitTest, Rules, refit_test
from pipeline.criticism.held_out import held_out_difference
from pipeline.criticism.rung import FitCache, SelectionStep
from pipeline.criticism.selection import ForwardSelection
from pipeline.errors import NegativeError


@dataclass(frozen=True, eq=False)
class ChosenSelection:
    """A selection without a search, and for each of its steps the test by which ``refine`` would accept or refuse it."""

    selection: ForwardSelection
    judged: tuple[RefitTest, ...]


def chosen_selection(cache: FitCache, terms: Sequence[str], rules: Rules) -> ChosenSelection:
    """The selection that adds ``terms`` in their order.

    Parameters
    ----------
    cache : fits and tests of the problem.
    terms : names of effects; none twice.
    rules : by which each step is judged.

    Raises
    ------
    NegativeError : the fit with one of the terms fails.
    """
    start = cache.fit(())
    if not start.ok:
        raise NegativeError(f"the fit of the given model failed: {start.why}", next_step="start from another --model")
    tests = [cache.tests(start, rules)]
    steps: list[SelectionStep] = []
    judged: list[RefitTest] = []
    for term in terms:
        before = tests[-1]
        fit = cache.fit((*before.fit.terms, term), before.fit)
        if not fit.ok:
            raise NegativeError(
                f"the fit with this effect failed: {fit.why}",
                value=term,
                next_step="leave it out, or add another first",
            )
        held = held_out_difference(before.fit, fit)
        steps.append(SelectionStep(term, fit, before.fit.chi2 - fit.chi2, held))
        judged.append(refit_test(before, len(fit.columns.get(term, ())), fit, (term,), rules))
        tests.append(cache.tests(fit, rules))
    return ChosenSelection(ForwardSelection(tuple(tests), tuple(steps), fits=cache.fits), tuple(judged))
