"""The ladder: the models tried, one rung a term, with the error on fitted and on held-out data.

confirmed   the held-out chi2 fell by more than 2 sd of the paired difference
partial     significant on the fitted data, not confirmed; or a misfit stays that nothing explains
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from .agreement import Agreement
from .problem import FitResult
from .regions import RegionShare, explained_by_region
from .selection import ForwardSelection
from .verdict import TermClass, Verdict, misfit

Status = Literal["confirmed", "partial"]


@dataclass(frozen=True, eq=False)
class Rung:
    """One model of the ladder.

    Parameters
    ----------
    term : added on this rung; ``None`` on the ground.
    status : ``None`` on the ground.
    terms : in the model on this rung.
    error_fit, error_validate, relative_error : of this model; ``None`` where they cannot be given.
    delta_chi2 : fall of the fitted chi2 against the rung below.
    held_fall, held_sd : fall of the held-out chi2 and sd of the paired difference.
    explained : share of the ground's excess chi2 that this model takes away; ``None`` where the ground has none.
    dropped : members removed for this rung.
    parameters, derived : name -> (value, sd).
    """

    term: str | None
    status: Status | None
    terms: tuple[str, ...]
    error_fit: float | None
    error_validate: float | None
    relative_error: float | None
    delta_chi2: float
    held_fall: float | None
    held_sd: float | None
    explained: float | None
    dropped: tuple[str, ...]
    parameters: Mapping[str, tuple[float, float]]
    derived: Mapping[str, tuple[float, float]]

    def to_dict(self) -> dict[str, Any]:
        """As plain JSON."""
        return {
            "effect": self.term,
            "status": self.status,
            "error_fit": self.error_fit,
            "error_validate": self.error_validate,
            "misfit_fit": misfit(self.error_fit),
            "misfit_validate": misfit(self.error_validate),
            "relative_error": self.relative_error,
            "delta_chi2": self.delta_chi2,
            "explained": self.explained,
            "held_out_fall": self.held_fall,
            "held_out_sd": self.held_sd,
            "terms": list(self.terms),
            "dropped": list(self.dropped),
            "parameters": {name: list(value) for name, value in self.parameters.items()},
            "derived": {name: list(value) for name, value in self.derived.items()},
        }


@dataclass(frozen=True, eq=False)
class Ladder:
    """The whole climb.

    Parameters
    ----------
    rungs : from the ground up.
    verdict : on the last rung: "adequate", "class", "unknown" or "fit_failed".
    terms : added and kept.
    classes : of the kept terms.
    wrong_form : kept term -> the partition on which its sizes disagree ("right place, wrong form").
    refused : term -> why it was not added.
    regions : where the ground failed, each with the share of its excess that the last rung explains.
    p_left : p-value of the structure that is left; ``left`` says where it is.
    why : what went wrong, for "fit_failed".
    """

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

    def to_dict(self) -> dict[str, Any]:
        """As plain JSON, with the keys of the contract and more."""
        return {
            "ladder": [rung.to_dict() for rung in self.rungs],
            "verdict": self.verdict,
            "effects": list(self.terms),
            "classes": [list(item.members) for item in self.classes if len(item.members) > 1],
            "wrong_form": {term: {"by": a.partition, "log_p": a.log_p} for term, a in self.wrong_form.items()},
            "refused": dict(self.refused),
            "regions": [
                {**item.labels, "kind": item.family, "share": item.share, "explained": explained}
                for item, explained in self.regions
            ],
            "p_left": self.p_left,
            "left": self.left,
            "why": self.why,
        }


def build(
    selection: ForwardSelection, said: Verdict, found: tuple[TermClass, ...], wrong_form: Mapping[str, Agreement]
) -> Ladder:
    """The ladder of a climb; a misfit that stays makes every rung partial."""
    if not selection.steps_tested:
        return Ladder((), said, (), (), why=selection.failed)
    ground = selection.steps_tested[0].fit
    excess = ground.chi2 - ground.dof
    # Within its own scatter an excess is nothing that could be explained.
    some = ground.noise_known and excess > 2.0 * np.sqrt(2.0 * ground.dof)
    rungs = [_rung(ground, None, None, 0.0, (), 0.0 if some else None)]
    for step in selection.steps:
        confirmed = step.held.standing == "confirmed" and said != "unknown" and step.term not in wrong_form
        held = (step.held.fall, step.held.sd) if step.fit.held else None
        share = min((ground.chi2 - step.fit.chi2) / excess, 1.0) if some else None
        status: Status = "confirmed" if confirmed else "partial"
        rungs.append(_rung(step.fit, step.term, status, step.delta_chi2, step.dropped, share, held))
    last = selection.last
    worst = last.goodness.worst
    added = {step.term for step in selection.steps}
    return Ladder(
        tuple(rungs),
        "adequate" if said == "effect" else said,
        tuple(term for term in last.fit.terms if term in added),
        found,
        wrong_form,
        selection.refused,
        explained_by_region(selection.steps_tested[0].regions, last.regions),
        last.goodness.p_value,
        f"{worst.test}: {worst.where}" if worst else "",
        selection.failed,
    )


def _rung(
    fit: FitResult,
    term: str | None,
    status: Status | None,
    delta_chi2: float,
    dropped: tuple[str, ...],
    share: float | None,
    held: tuple[float, float] | None = None,
) -> Rung:
    return Rung(
        term,
        status,
        fit.terms,
        fit.error_of("fit"),
        fit.error_of("validate"),
        fit.relative_error.get("fit"),
        delta_chi2,
        held[0] if held else None,
        held[1] if held else None,
        share,
        dropped,
        fit.parameters,
        fit.derived,
    )
