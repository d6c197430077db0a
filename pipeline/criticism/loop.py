"""Diagnose and refine: the loop's two public faces.

diagnose    what is missing?  The climb, told as candidates, classes and a verdict on the model that was given.
refine      add it.           The climb, told as a ladder with the verdict on its last rung.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .agreement import Agreement, agreement, partitions
from .fit_tests import FitTests, Rules
from .goodness import ResidualTests
from .ladder import Ladder, build
from .problem import FitResult, Problem
from .scores import Score
from .selection import ForwardSelection, forward_selection
from .verdict import TermClass, Verdict, classes, verdict


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """What a model lacks.

    Parameters
    ----------
    verdict : see ``pipeline.criticism.verdict``.
    terms : named, together an explanation of the whole misfit; empty for "adequate" and "unknown".
    scores : of every absent term at the given model, most significant first.
    error_after : term -> error on the fitted data once it is in; refitted where that was done, else expected from its score.
    classes : of the named terms.
    invisible : terms that these data could not have shown.
    before, after : structure in the residual of the given model, and with the named terms in.
    fit, fit_after : the given model, and the one that the climb ended with.
    wrong_form : term -> the partition on which its sizes disagree.
    why : what went wrong, for "fit_failed".
    """

    verdict: Verdict
    terms: tuple[str, ...]
    scores: tuple[Score, ...]
    error_after: Mapping[str, float | None]
    classes: tuple[TermClass, ...]
    invisible: tuple[str, ...]
    before: ResidualTests | None
    after: ResidualTests | None
    fit: FitResult | None
    fit_after: FitResult | None
    wrong_form: Mapping[str, Agreement]
    why: str = ""

    def to_dict(self) -> dict[str, Any]:
        """As plain JSON, with the keys of the contract and more."""
        number = {name: k for k, item in enumerate(self.classes) for name in item.members}
        error = {} if self.fit is None else {part: self.fit.error_of(part) for part in ("fit", "validate")}
        return {
            "verdict": self.verdict,
            "effects": list(self.terms),
            "candidates": [
                {
                    "effect": score.name,
                    "delta_chi2": score.delta_chi2,
                    "p_value": score.p_value,
                    "estimate": {name: [v, None if np.isnan(sd) else sd] for name, (v, sd) in score.estimate.items()},
                    "error_after": self.error_after.get(score.name),
                    "class": number.get(score.name),
                    "detectable": score.detectable,
                    "surviving_share": score.surviving_share,
                    "snr_at_reach": None if np.isinf(score.snr_at_reach) else score.snr_at_reach,
                }
                for score in self.scores
            ],
            "classes": [list(item.members) for item in self.classes if len(item.members) > 1],
            "invisible": list(self.invisible),
            "error": error,
            "p_left": None if self.after is None else self.after.p_value,
            "left": "" if self.after is None or self.after.worst is None else self.after.worst.where,
            "wrong_form": {term: {"by": a.partition, "log_p": a.log_p} for term, a in self.wrong_form.items()},
            "why": self.why,
        }


def diagnose(problem: Problem, terms: tuple[str, ...] = (), rules: Rules | None = None) -> Diagnosis:
    """Say what the model with these terms lacks; at most ``rules.together`` terms are named."""
    rules = rules or Rules()
    return as_diagnosis(
        problem, forward_selection(problem, terms, replace(rules, rungs=min(rules.rungs, rules.together))), rules
    )


def as_diagnosis(problem: Problem, selection: ForwardSelection, rules: Rules | None = None) -> Diagnosis:
    """A climb of at most ``rules.together`` steps, told as what the model lacked where it began."""
    rules = rules or Rules()
    if not selection.steps_tested:
        fit = next(iter(selection.fits.values()))
        return Diagnosis("fit_failed", (), (), {}, (), (), None, None, fit, None, {}, selection.failed)
    found, said, wrong = _judge(problem, selection, rules)
    first, last = selection.steps_tested[0], selection.last
    added = {step.term for step in selection.steps}
    named = tuple(term for term in last.fit.terms if term in added) if said in ("effect", "class") else ()
    return Diagnosis(
        said,
        named,
        first.scores,
        {score.name: _error_after(selection, score) for score in first.scores},
        found if named else (),
        first.invisible,
        first.goodness,
        last.goodness,
        first.fit,
        last.fit,
        wrong,
        selection.failed,
    )


def refine(problem: Problem, terms: tuple[str, ...] = (), rules: Rules | None = None) -> Ladder:
    """Climb from the model with these terms until nothing more is warranted."""
    return as_ladder(problem, forward_selection(problem, terms, rules), rules)


def as_ladder(problem: Problem, selection: ForwardSelection, rules: Rules | None = None) -> Ladder:
    """A climb, told rung by rung."""
    rules = rules or Rules()
    if not selection.steps_tested:
        return build(selection, "fit_failed", (), {})
    found, said, wrong = _judge(problem, selection, rules)
    return build(selection, said, found, wrong)


def _judge(
    problem: Problem, selection: ForwardSelection, rules: Rules
) -> tuple[tuple[TermClass, ...], Verdict, dict[str, Agreement]]:
    """Classes, verdict and wrong forms; a model that leaves a misfit has no classes worth a refit."""
    said = verdict(selection, (), rules)
    found = classes(problem, selection, rules) if said == "adequate" and selection.steps else ()
    return found, verdict(selection, found, rules), wrong_forms(selection.last, rules.alpha)


def wrong_forms(here: FitTests, alpha: float) -> dict[str, Agreement]:
    """Terms of a fit whose size disagrees between blocks, or between the values of a label."""
    fit = here.fit
    asked = [
        (term, columns, name, parts)
        for term, columns in fit.columns.items()
        if columns
        for name, parts in partitions(fit).items()
    ]
    found: dict[str, Agreement] = {}
    for term, columns, name, parts in asked:
        seen = agreement(here.base, name, parts, columns)
        if seen.log_p < np.log(alpha / len(asked)) and (term not in found or seen.log_p < found[term].log_p):
            found[term] = seen
    return found


def _error_after(selection: ForwardSelection, score: Score) -> float | None:
    fit = selection.steps_tested[0].fit
    refit = selection.fits.get(frozenset((*fit.terms, score.name)))
    if refit is not None and refit.ok:
        return refit.error_of("fit")
    before = fit.error_of("fit")
    return None if before is None else float(np.sqrt(max(before**2 - score.delta_chi2 / fit.rows, 0.0)))
