"""The answers of forward selection: ``refine`` gives a ladder of models, ``diagnose`` what the first model lacks.

    confirmed   the held-out chi2 fell by more than 2 sd of the paired difference
    partial     significant on the fitted data, but not confirmed; or a misfit is left that nothing explains

Start here: both functions take a ``Problem``, select terms (``selection``) and judge the last model (``verdict``).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from .fit_tests import Rules
from .goodness import Agreement, ResidualTests
from .problem import FitResult, Problem
from .regions import RegionShare, explained_by_region
from .rung import Fits, SelectionStep
from .scores import Score
from .selection import ForwardSelection, forward_selection
from .verdict import TermClass, Verdict, judge, why_failed

Status = Literal["confirmed", "partial"]


@dataclass(frozen=True, eq=False)
class Rung:
    """One model of the ladder.

    Parameters
    ----------
    term, status : added on this rung, and whether it is confirmed; ``None`` on the first.
    terms : in the model on this rung.
    error_fit, error_validate, relative_error : of this model [sigma], [sigma], [1]; ``None`` where not known.
    delta_chi2 : decrease of the fitted chi2 from the rung before.
    held_delta_chi2, held_sd : decrease of the held-out chi2 and its sd.
    explained : share of the first model's excess chi2 that this model explains; ``None`` without a significant excess.
    dropped : terms removed on this rung.
    parameters, derived : name -> (value, sd), each in the unit of the parameter.
    """

    term: str | None
    status: Status | None
    terms: tuple[str, ...]
    error_fit: float | None
    error_validate: float | None
    relative_error: float | None
    delta_chi2: float
    held_delta_chi2: float | None
    held_sd: float | None
    explained: float | None
    dropped: tuple[str, ...]
    parameters: Mapping[str, tuple[float, float]]
    derived: Mapping[str, tuple[float, float]]


@dataclass(frozen=True, eq=False)
class Ladder:
    """The models of a forward selection.

    Parameters
    ----------
    selection : all fits and tests.
    rungs : the first model, then one rung per added term.
    verdict : on the last rung: "adequate", "class", "unknown" or "fit_failed".
    terms : added and kept.
    classes : of the kept terms.
    wrong_form : kept term -> the partition between whose parts its fitted size differs.
    refused : term -> why it was not added.
    regions : where the first model fails, each with the share of its excess that the last rung explains.
    p_left, left : p-value of the structure that is left, and "test: where".
    why : the reason of "fit_failed".
    imitating : terms for which the verdict is "unknown" although they leave no misfit (``Judgement``).
    """

    selection: ForwardSelection
    rungs: tuple[Rung, ...]
    verdict: Verdict
    terms: tuple[str, ...]
    classes: tuple[TermClass, ...]
    wrong_form: Mapping[str, Agreement] = field(default_factory=dict)
    refused: Mapping[str, str] = field(default_factory=dict)
    regions: tuple[tuple[RegionShare, float], ...] = ()
    p_left: float = 1.0
    left: str = ""
    why: str = ""
    imitating: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """What a model lacks.

    Parameters
    ----------
    verdict : see ``pipeline.criticism.verdict``.
    terms : that together explain the whole misfit; empty for "adequate" and "unknown".
    scores : of every absent term at the given model, most significant first.
    error_after : term -> error [sigma] on the fitted data with the term in the model, by a refit where there was one,
        else expected from its score.
    classes : of ``terms``.
    invisible : terms that these data could not have shown.
    error : "fit" and "validate" -> error of the given model [sigma].
    p_left, left : p-value of the structure that the last model of the selection leaves, and "test: where".
    fit, fit_after : the given model, and the last one of the selection.
    wrong_form : term -> the partition between whose parts its fitted size differs.
    why : the reason of "fit_failed".
    imitating : as of :class:`Ladder`.
    """

    verdict: Verdict
    terms: tuple[str, ...]
    scores: tuple[Score, ...]
    error_after: Mapping[str, float | None]
    classes: tuple[TermClass, ...]
    invisible: tuple[str, ...]
    error: Mapping[str, float | None]
    p_left: float | None
    left: str
    fit: FitResult
    fit_after: FitResult | None
    wrong_form: Mapping[str, Agreement]
    why: str = ""
    imitating: tuple[str, ...] = ()


def refine(problem: Problem, terms: tuple[str, ...] = (), rules: Rules | None = None) -> Ladder:
    """Add terms to the model with ``terms`` until no further one is justified."""
    return as_ladder(problem, forward_selection(problem, terms, rules), rules)


def as_ladder(problem: Problem, selection: ForwardSelection, rules: Rules | None = None) -> Ladder:
    """The ladder of a selection; a misfit that is left makes every rung partial."""
    judgement = judge(problem, selection, rules or Rules())
    if not selection.tests:
        return Ladder(selection, (), judgement.verdict, (), (), why=selection.failed)
    start, last = selection.tests[0], selection.last
    excess = start.fit.chi2 - start.fit.dof
    # An excess within its own scatter is nothing that a term could explain.
    significant = start.fit.noise_known and excess > 2.0 * np.sqrt(2.0 * start.fit.dof)
    rungs = [_rung(start.fit, 0.0 if significant else None)]
    for step in selection.steps:
        supported = judgement.verdict not in ("unknown", "fit_failed") and step.term not in judgement.wrong_form
        share = min((start.fit.chi2 - step.fit.chi2) / excess, 1.0) if significant else None
        rungs.append(_rung(step.fit, share, step, supported))
    return Ladder(
        selection,
        tuple(rungs),
        "adequate" if judgement.verdict == "effect" else judgement.verdict,
        selection.added,
        judgement.classes,
        judgement.wrong_form,
        selection.refused,
        explained_by_region(start.regions, last.regions),
        last.goodness.p_value,
        _left(last.goodness),
        why_failed(selection, judgement.verdict),
        judgement.imitating,
    )


def _left(tests: ResidualTests) -> str:
    """The most significant structure of a residual, as "test: where"."""
    return f"{tests.worst.test}: {tests.worst.where}" if tests.worst else ""


def _rung(fit: FitResult, explained: float | None, step: SelectionStep | None = None, supported: bool = False) -> Rung:
    """The rung of a fit: the first one without ``step``; only a ``supported`` step can be confirmed."""
    held = step.held if step is not None and fit.held else None
    status: Status | None = None
    if step is not None:
        status = "confirmed" if supported and step.held.status == "confirmed" else "partial"
    return Rung(
        None if step is None else step.term,
        status,
        fit.terms,
        fit.error_of("fit"),
        fit.error_of("validate"),
        fit.relative_error.get("fit"),
        0.0 if step is None else step.delta_chi2,
        None if held is None else held.delta_chi2,
        None if held is None else held.sd,
        explained,
        () if step is None else step.dropped,
        fit.parameters,
        fit.derived,
    )


def diagnose(problem: Problem, terms: tuple[str, ...] = (), rules: Rules | None = None) -> Diagnosis:
    """Say what the model with ``terms`` lacks, by a forward selection."""
    return as_diagnosis(problem, forward_selection(problem, terms, rules), rules)


def as_diagnosis(problem: Problem, selection: ForwardSelection, rules: Rules | None = None) -> Diagnosis:
    """What the first model of a selection lacks."""
    judgement = judge(problem, selection, rules or Rules())
    if not selection.tests:
        fit = next(iter(selection.fits.values()))
        return Diagnosis("fit_failed", (), (), {}, (), (), _errors(fit), None, "", fit, None, {}, selection.failed)
    first, last = selection.tests[0], selection.last
    named = selection.added if judgement.verdict in ("effect", "class") else ()
    return Diagnosis(
        judgement.verdict,
        named,
        first.scores,
        {score.name: _error_after(first.fit, judgement.fits, score) for score in first.scores},
        judgement.classes if named else (),
        first.invisible,
        _errors(first.fit),
        last.goodness.p_value,
        _left(last.goodness),
        first.fit,
        last.fit,
        judgement.wrong_form,
        why_failed(selection, judgement.verdict),
        judgement.imitating,
    )


def _errors(fit: FitResult) -> dict[str, float | None]:
    return {role: fit.error_of(role) for role in ("fit", "validate")}


def _error_after(fit: FitResult, fits: Fits, score: Score) -> float | None:
    """Error on the fitted data with the term of ``score`` added to ``fit``; expected where it was not refitted."""
    refit = fits.get(frozenset((*fit.terms, score.name)))
    if refit is not None and refit.ok:
        return refit.error_of("fit")
    before = fit.error_of("fit")
    return None if before is None else float(np.sqrt(max(before**2 - score.delta_chi2 / fit.rows, 0.0)))
