"""The verdict: what is left decides, not what fell.

fit_failed  the given model, or every term that its misfit calls for, could not be fitted; never evidence
unknown     a significant misfit is left that nothing explains, or only several terms that hardly stand by themselves
adequate    nothing is missing
effect      the added terms explain everything, and no other term could stand for one of them
class       the same, but another term could
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from .classes import Rival, rivals
from .fit_tests import Rules
from .problem import Problem
from .selection import SURE, ForwardSelection, tail_of_rise, wald

Verdict = Literal["adequate", "effect", "class", "unknown", "fit_failed"]
#: Times the largest noise level there may be, above which what is left is plainly no noise.
_PLAIN = 1.5
#: Below this sine the projection is not trusted to exclude a rival of a strong term, nor to say what both would bring together:
#: signatures that were taken at an earlier fit differ by more than that.
_CLOSE = 0.1
#: So many times the fall of a term that was the best cannot be another's own.
_CONCERT = 2.0


@dataclass(frozen=True)
class TermClass:
    """A term and all that these data cannot tell from it; ``rivals`` nearest first, members or not."""

    term: str
    members: tuple[str, ...]
    rivals: tuple[Rival, ...]


def classes(problem: Problem, selection: ForwardSelection, rules: Rules) -> tuple[TermClass, ...]:
    """The class of every added term, by refits of those rivals that projection cannot exclude."""
    here = selection.last
    added = {step.term for step in selection.steps}
    critical = here.null.critical(rules.alpha)
    found = []
    for term in here.fit.terms:
        if term not in added:
            continue
        if not here.fit.columns.get(term):
            found.append(TermClass(term, (term,), ()))
            continue
        near = rivals(here.fit, term, here.signatures)
        members = [term]
        size = len(here.fit.columns[term])
        asked = [
            rival for rival in near if rival.sin_angle < _CLOSE or tail_of_rise(rival.left / 4.0, size, here) > critical
        ]
        for rival in asked[: rules.class_refits]:
            swapped = tuple(rival.name if name == term else name for name in here.fit.terms)
            fit = selection.fits.get(frozenset(swapped)) or problem.fit(swapped, here.fit)
            selection.fits[frozenset(swapped)] = fit
            if not fit.ok:
                continue
            left = max(fit.chi2 - here.fit.chi2 + (rival.joint if rival.sin_angle >= _CLOSE else 0.0), 0.0)
            if tail_of_rise(left, size, here) > critical:
                members.append(rival.name)
        found.append(TermClass(term, tuple(members), near))
    return tuple(found)


def verdict(selection: ForwardSelection, found: tuple[TermClass, ...], rules: Rules) -> Verdict:
    """The verdict on the last model of a climb."""
    if selection.failed or not selection.steps_tested:
        return "fit_failed"
    last = selection.last
    # F-tests take all that is left for white noise: without a noise level a term that its refit or the held-out data do not
    # support is no evidence, what is left above the bound of the noise is.
    doubted = () if last.fit.noise_known else selection.refused
    if any(score.name not in doubted for score in last.significant(rules.alpha)):
        return "unknown"
    if last.goodness.p_value < rules.alpha_left or (last.fit.noise_bounded and last.goodness.level > _PLAIN):
        return "unknown"
    if not found:
        return "adequate"
    if any(not supported(selection, item.term) for item in found) and len(found) > 1:
        return "unknown"
    return "class" if any(len(item.members) > 1 for item in found) else "effect"


def supported(selection: ForwardSelection, term: str) -> bool:
    """Whether a term stands without the help of others: confirmed on held-out data, or far beyond doubt on the fitted.

    Two terms that just pass can together imitate a third that is no candidate; a single one hardly can.  Where neither a
    noise level nor held-out data exist nothing stands but the tests that each term has passed, and they are taken for it.
    """
    if not selection.last.fit.noise_known and not selection.last.fit.held:
        return True
    if imitates_jointly(selection, term):
        return False
    confirmed = any(step.term == term and step.held.standing == "confirmed" for step in selection.steps)
    return confirmed or not selection.last.fit.columns.get(term) or wald(selection.last.fit, term) > SURE**2


def imitates_jointly(selection: ForwardSelection, term: str) -> bool:
    """Whether a term brought little until another came that brought more, though the best one is added first.

    Effects that are there each take their own part of the misfit.  Where the falls grow, the terms imitate together what none
    of them is.
    """
    kept = [step for step in selection.steps if step.alone and step.term in selection.last.fit.terms]
    places = [k for k, step in enumerate(kept) if step.term == term]
    if not places or kept[places[-1]].dropped:
        return False
    own = places[-1]
    return any(step.delta_chi2 > _CONCERT * kept[own].delta_chi2 and not step.dropped for step in kept[own + 1 :])


def misfit(error: float | None) -> float | None:
    """sqrt(max(error^2 - 1, 0)), which still moves where error rounds to 1.000."""
    return None if error is None else float(np.sqrt(max(error * error - 1.0, 0.0)))
