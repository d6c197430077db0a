"""The verdict on a selected model, and the terms that these data cannot tell from the selected ones.

    fit_failed  the given model, or every term that its misfit calls for, could not be fitted; or a misfit is left that a term
                whose fit failed promises to explain; never evidence
    unknown     a significant misfit is left that nothing explains, or only several terms with little support each
    adequate    nothing is missing
    effect      the added terms explain everything, and no other term could replace one of them
    class       the same, but another term could

The verdict depends on the misfit that is left, not on how much it fell.

    T(A|B) = decrease of chi2 when A is added to B

A and B are one class when T(A|B) and T(B|A) are both insignificant, that is, when either alone explains the evidence.  Rivals B
are first compared by projection at the fit with A: the scores of all columns with the size of A put back, s + G_A theta_A.
Those that come near are refitted in place of A; then T(A|B) = chi2_B - chi2_A + T(B|A).  A class holds the rivals of the
selected term only; it is not extended by rivals of its members.

    sin(angle) between the signatures of A and B, baseline projected out; telling them apart at 5 sigma needs SNR 5 / sin(angle)
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from ..arrays import RANK, FloatArray, IntArray
from .budget import CLEAR_SNR, DETECTABLE_SNR
from .fit_tests import FitTests, Rules, is_clear, residual_variance
from .goodness import Agreement, agreement, partitions
from .problem import FitResult, Problem, Signatures
from .rung import FitCache, Fits
from .scores import Projected, baseline, project
from .selection import ForwardSelection

Verdict = Literal["adequate", "effect", "class", "unknown", "fit_failed"]
#: Rms of the residual, relative to the largest possible noise level, above which a misfit is certain.  Without it a Silverbox
#: record with hold = "zoh" is "adequate" at a relative error of 23 %.
_CERTAIN_MISFIT = 1.5
#: Relative change of the fitted records up to which signatures of an earlier fit are used.  Sines that are smaller are not
#: trusted to exclude a rival of a strong term, nor for T(B|A).
STALE = 0.1
#: A term that was the best candidate cannot be followed by one that lowers chi2 by more than this factor times as much.
_JOINT_RATIO = 2.0


@dataclass(frozen=True)
class Rival:
    """An absent term B compared with a selected term A.

    Parameters
    ----------
    name : of the rival.
    sin_angle : sine of the angle between both signatures.
    snr_needed : SNR that tells them apart at 5 sigma.
    left, joint : T(A|B) and T(B|A) by projection.
    """

    name: str
    sin_angle: float
    snr_needed: float
    left: float
    joint: float


@dataclass(frozen=True)
class TermClass:
    """A selected term, the members of its class (itself first), and all rivals, nearest first."""

    term: str
    members: tuple[str, ...]
    rivals: tuple[Rival, ...]


@dataclass(frozen=True, eq=False)
class Judgement:
    """What a forward selection amounts to.

    Parameters
    ----------
    verdict : on its last model.
    classes : of the added terms; empty where a misfit is left.
    wrong_form : term -> the partition between whose parts its fitted size differs.
    fits : all fits by their terms, those of rivals included.
    """

    verdict: Verdict
    classes: tuple[TermClass, ...] = ()
    wrong_form: Mapping[str, Agreement] = field(default_factory=dict)
    fits: Fits = field(default_factory=dict)

    @property
    def imitating(self) -> tuple[str, ...]:
        """Added terms that leave no misfit together although one of them is not supported by itself; () for other verdicts."""
        return tuple(item.term for item in self.classes) if self.verdict == "unknown" else ()


def judge(problem: Problem, selection: ForwardSelection, rules: Rules) -> Judgement:
    """Verdict, classes and disagreeing sizes; rivals are refitted only where the model leaves no misfit."""
    verdict = verdict_of(selection, (), rules)
    if verdict == "fit_failed" and not selection.tests:
        return Judgement(verdict, fits=selection.fits)
    cache = FitCache(problem, selection.fits)
    classes = _classes(cache, selection, rules) if verdict == "adequate" and selection.steps else ()
    return Judgement(
        verdict_of(selection, classes, rules), classes, _wrong_forms(selection.last, rules.alpha), cache.fits
    )


def verdict_of(selection: ForwardSelection, classes: tuple[TermClass, ...], rules: Rules) -> Verdict:
    """The verdict on the last model of a selection, given the classes of the added terms."""
    if selection.failed or not selection.tests:
        return "fit_failed"
    found = _judged(selection, classes, rules)
    return "fit_failed" if found == "unknown" and selection.unfinished else found


def why_failed(selection: ForwardSelection, verdict: Verdict) -> str:
    """The reason of the verdict "fit_failed"; empty for others."""
    if verdict != "fit_failed" or selection.failed:
        return selection.failed
    reasons = "; ".join(f"{name}: {why}" for name, why in selection.unfinished.items())
    return f"a misfit is left that may be due to an effect whose fit did not succeed ({reasons})"


def _judged(selection: ForwardSelection, classes: tuple[TermClass, ...], rules: Rules) -> Verdict:
    """The verdict where fits that failed do not matter."""
    last = selection.last
    # With an unknown noise level an F-test takes every misfit for white noise.  A term that its refit or the held-out data
    # refused is then no evidence; a residual above the bound of the noise is.
    ignored = () if last.fit.noise_known else selection.refused
    if any(score.name not in ignored for score in last.significant(rules.alpha)):
        return "unknown"
    if last.goodness.p_value < rules.alpha_left or (last.fit.noise_bounded and last.goodness.level > _CERTAIN_MISFIT):
        return "unknown"
    if last.fit.misfit:
        return "unknown"
    if not classes:
        return "adequate"
    if any(not is_supported(selection, item.term) for item in classes) and len(classes) > 1:
        return "unknown"
    return "class" if any(len(item.members) > 1 for item in classes) else "effect"


def is_supported(selection: ForwardSelection, term: str) -> bool:
    """Whether a term is significant by itself: confirmed on held-out data, or by more than 8 sigma on the fitted data.

    The Wald statistic says nothing of a term whose parameters do not exist at its null, a clip level; what chi2 rises by without
    it takes its place.  Without that, three of four campaigns with a clipping converter beside another effect were "unknown",
    although both were found at SNR 97 to 468 and nothing was left (two 1, 18, 20, seed 2061).

    Two terms that are just significant can together imitate a third that is not a candidate; a single one hardly can.  Without
    a noise level and without held-out data, no further test is possible, and the term counts as supported.
    """
    if not selection.last.fit.noise_known and not selection.last.fit.held:
        return True
    if imitates_jointly(selection, term):
        return False
    confirmed = any(step.term == term and step.held.status == "confirmed" for step in selection.steps)
    clear = is_clear(selection.last.fit, term) or _is_missed(selection, term)
    return confirmed or clear or not selection.last.fit.columns.get(term)


def _is_missed(selection: ForwardSelection, term: str) -> bool:
    """Whether chi2 is larger by more than 64 (8 sigma) without a term that has no Wald statistic."""
    fit = selection.last.fit
    if any(fit.shifts.get(term, ())):
        return False
    smaller = selection.fits.get(frozenset(fit.terms) - {term})
    return smaller is not None and smaller.ok and smaller.chi2 - fit.chi2 > CLEAR_SNR**2 * residual_variance(fit)


def imitates_jointly(selection: ForwardSelection, term: str) -> bool:
    """Whether a later term lowered chi2 by much more than this one, although the best candidate is added first.

    Effects that are present each explain their own part of the misfit.  Where delta_chi2 grows from step to step, the terms
    together imitate an effect that none of them is.
    """
    kept = [step for step in selection.steps if step.alone and step.term in selection.last.fit.terms]
    places = [k for k, step in enumerate(kept) if step.term == term]
    if not places or kept[places[-1]].dropped:
        return False
    own = places[-1]
    return any(step.delta_chi2 > _JOINT_RATIO * kept[own].delta_chi2 and not step.dropped for step in kept[own + 1 :])


def _wrong_forms(tests: FitTests, alpha: float) -> dict[str, Agreement]:
    """Terms of a fit whose size differs between blocks, or between the values of a label."""
    fit = tests.fit
    pairs = [
        (term, columns, name, parts)
        for term, columns in fit.columns.items()
        if columns
        for name, parts in partitions(fit).items()
    ]
    wrong: dict[str, Agreement] = {}
    for term, columns, name, parts in pairs:
        result = agreement(tests.base, name, parts, columns)
        if result.log_p < np.log(alpha / len(pairs)) and (term not in wrong or result.log_p < wrong[term].log_p):
            wrong[term] = result
    return wrong


def _classes(cache: FitCache, selection: ForwardSelection, rules: Rules) -> tuple[TermClass, ...]:
    """The class of every added term, by refits of those rivals that projection cannot exclude."""
    last = selection.last
    classes = []
    for term in selection.added:
        if not last.fit.columns.get(term):
            classes.append(TermClass(term, (term,), ()))
            continue
        every = rivals(last.fit, term, last.signatures)
        members = [term]
        size = len(last.fit.columns[term])
        near = [r for r in every if r.sin_angle < STALE or last.is_negligible(r.left / 4.0, size, rules.alpha)]
        for rival in near[: rules.class_refits]:
            swapped = tuple(rival.name if name == term else name for name in last.fit.terms)
            fit = cache.fit(swapped, last.fit)
            if not fit.ok:
                continue
            left = max(fit.chi2 - last.fit.chi2 + (rival.joint if rival.sin_angle >= STALE else 0.0), 0.0)
            if last.is_negligible(left, size, rules.alpha):
                members.append(rival.name)
        classes.append(TermClass(term, tuple(members), every))
    return tuple(classes)


def rivals(fit: FitResult, term: str, signatures: Signatures) -> tuple[Rival, ...]:
    """T(A|B), T(B|A) and the sine of the angle for every absent term B and one fitted term A, smallest T(A|B) first.

    Parameters
    ----------
    fit : with ``term`` in its model.
    term : the selected term.
    signatures : of the absent terms, at this fit.
    """
    own = list(fit.columns[term])
    k = len(own)
    selected = tuple(jac[:, own] for jac in fit.jacobian)
    projected = project(baseline(fit, tuple(own)), signatures.blocks, signatures.grams, selected)
    size = np.asarray(fit.shifts[term], dtype=np.float64) * projected.norms[:k]
    score = projected.score + projected.gram[:, :k] @ size
    whole = float(score[:k] @ _pinv(projected.gram[:k, :k]) @ score[:k])
    every = []
    for candidate in signatures.candidates:
        left, joint, sine = np.inf, 0.0, 1.0
        for cell in candidate.cells:
            columns = np.arange(k, projected.score.size)[cell]
            left_cell, joint_cell, sine_cell = _compare(projected, score, k, columns, whole)
            if left_cell < left:
                left, sine = left_cell, sine_cell
            joint = max(joint, joint_cell)
        every.append(Rival(candidate.name, sine, DETECTABLE_SNR / max(sine, 1e-12), left, joint))
    return tuple(sorted(every, key=lambda rival: rival.left))


def _compare(
    projected: Projected, score: FloatArray, k: int, columns: IntArray, whole: float
) -> tuple[float, float, float]:
    """T(A|B), T(B|A) and the sine of the angle between A and B; A is the first k columns."""
    a = projected.gram[:k, :k]
    b = projected.gram[np.ix_(columns, columns)]
    ab = projected.gram[:k][:, columns]
    b_inverse, a_inverse = _pinv(b), _pinv(a)
    both = np.concatenate([np.arange(k), columns])
    together = float(score[both] @ _pinv(projected.gram[np.ix_(both, both)]) @ score[both])
    alone = float(score[columns] @ b_inverse @ score[columns])
    # Directions of A that the fit did not use do not matter, so the angle is that of the fitted direction of A.
    direction = a_inverse @ score[:k]
    length = float(direction @ a @ direction)
    explained = float(direction @ ab @ b_inverse @ ab.T @ direction)
    sine = float(np.sqrt(max(1.0 - explained / max(length, 1e-300), 0.0)))
    return max(together - alone, 0.0), max(together - whole, 0.0), sine


def _pinv(gram: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.pinv(gram, rcond=RANK, hermitian=True))
