"""The learning loop on a modal record: the same three questions, put to poles and residues that somebody else identified.

Without declared sd the noise level is unknown: errors are null, relative errors are given, significance is by F-tests at 5 %
family-wise, and pairs are tried where no single effect passes.  With declared sd the rules are those of a campaign.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from pipeline.criticism.fit_tests import FitTests, Rules, fit_tests
from pipeline.criticism.ladder import Diagnosis, Ladder, Rung
from pipeline.criticism.ladder import diagnose as examine
from pipeline.criticism.ladder import refine as forward_selection
from pipeline.criticism.pairs import best_pairs
from pipeline.criticism.problem import FitResult
from pipeline.criticism.scores import Score
from pipeline.criticism.verdict import misfit
from pipeline.device.model import Model
from pipeline.experiment.files.modal_record import ModalRecord
from pipeline.inference.modal.axes import NAMES
from pipeline.learning.modal.problem import ModalProblem
from pipeline.learning.where.modal import entries_by_misfit

ALPHA_UNKNOWN_NOISE = 0.05
_PAIRS = 6
_RIVALS = 4


def rules_for(record: ModalRecord) -> Rules:
    """5 % family-wise where the noise level is unknown, the rules of a campaign where it is declared.

    With an unknown noise level nothing says when a misfit is explained, so a diagnosis climbs as far as a ladder.
    """
    return Rules(alpha=ALPHA_UNKNOWN_NOISE, max_named=Rules().rungs) if record.sd is None else Rules()


@dataclass(frozen=True, eq=False)
class ModalComparison:
    """How well a model explains a modal record, and in which entry of which mode it does not."""

    view: ModalProblem

    @cached_property
    def fit(self) -> FitResult:
        """The fit behind it."""
        return self.view.fit(())

    def to_dict(self) -> dict[str, Any]:
        """As plain JSON, the keys of a campaign's comparison and more."""
        fit = self.fit
        if not fit.ok:
            return {"error": {}, "relative_error": {}, "where": [], "parameters": {}, "fit_ok": False, "why": fit.why}
        error = fit.error_of("fit")
        return {
            "error": {"fit": error, "validate": None},
            "relative_error": dict(fit.relative_error),
            "misfit": {"fit": misfit(error), "validate": None},
            "noise": {
                "sigma": self.view.relative_sd(fit).tolist(),
                "from": "declared" if self.view.noise_known else "residual",
                "unit": "norm of each mode",
            },
            "where": entries_by_misfit(self.view, fit),
            "parameters": {name: list(value) for name, value in fit.parameters.items()},
            "dof": fit.dof,
            **_axes(self.view, fit),
            "fit_ok": True,
        }


@dataclass(frozen=True, eq=False)
class ModalDiagnosed:
    """What a model lacks on a modal record."""

    view: ModalProblem
    diagnosis: Diagnosis

    @property
    def verdict(self) -> str:
        """adequate, effect, class, unknown or fit_failed."""
        return self.diagnosis.verdict

    @property
    def effects(self) -> tuple[str, ...]:
        """Named effects."""
        return self.diagnosis.terms

    @property
    def classes(self) -> tuple[tuple[str, ...], ...]:
        """Classes of more than one member."""
        return tuple(tuple(c.members) for c in self.diagnosis.classes if len(c.members) > 1)

    def to_dict(self) -> dict[str, Any]:
        """As plain JSON, the keys of a campaign's diagnosis and more."""
        out: dict[str, Any] = {"separating_record": None, **self.diagnosis.to_dict()}
        if self.diagnosis.fit is None or not self.diagnosis.fit.ok:
            return out
        seen = fit_tests(self.view, self.diagnosis.fit, rules_for(self.view.record))
        for told, score in zip(out["candidates"], self.diagnosis.scores):
            refit = self.view.fit((score.name,), seen.fit)
            told.update(_tested(seen, score))
            told["relative_error_after"] = refit.relative_error.get("fit") if refit.ok else None
        out["pairs"] = [
            {"effects": list(pair.names), "share_of_chi2": pair.delta_chi2 / seen.fit.chi2, "p_value": pair.p_value}
            for pair in best_pairs(seen.projected, seen.signatures.candidates, self.view.noise_known)[:_PAIRS]
        ]
        out["relative_error"] = dict(seen.fit.relative_error)
        out["dof"] = seen.fit.dof
        out["declared"] = list(self.view.declared)
        out["invisible"] = [*out["invisible"], *self.view.unseen]
        return out


@dataclass(frozen=True, eq=False)
class ModalRefined:
    """The ladder of a modal record, with theta, split and the four thetas on every rung."""

    view: ModalProblem
    ladder: Ladder

    @property
    def verdict(self) -> str:
        """That of the last rung."""
        return self.ladder.verdict

    @property
    def effects(self) -> tuple[str, ...]:
        """Effects that were added."""
        return self.ladder.terms

    @property
    def classes(self) -> tuple[tuple[str, ...], ...]:
        """Classes of more than one member."""
        return tuple(tuple(c.members) for c in self.ladder.classes if len(c.members) > 1)

    def to_dict(self) -> dict[str, Any]:
        """As plain JSON, the keys of a campaign's ladder and more."""
        out = self.ladder.to_dict()
        if not self.ladder.rungs:
            return out
        fits = [self.view.fit(rung.terms) for rung in self.ladder.rungs]
        for told, rung, fit, before in zip(out["ladder"], self.ladder.rungs, fits, [None, *fits]):
            told.update(_axes(self.view, fit))
            told["dof"] = fit.dof
            told.update(self._why(rung, before))
        first, last = fits[0], self.view.fit(self.effects)
        for key, fit in (("before_", first), ("", last)):
            for name in ("theta_deg", "split_hz"):
                if name in fit.derived:
                    stem, _, unit = name.partition("_")
                    out[f"{stem}_{key}{unit}"] = list(fit.derived[name])
        out["parameters"] = {name: list(value) for name, value in last.parameters.items()}
        out["relative_error"] = {"before": first.relative_error["fit"], "after": last.relative_error["fit"]}
        out["where"] = entries_by_misfit(self.view, last)
        out["candidates_left"] = _candidates(fit_tests(self.view, last, rules_for(self.view.record)))
        out["invisible"], out["declared"] = list(self.view.unseen), list(self.view.declared)
        return out

    def _why(self, rung: Rung, before: FitResult | None) -> dict[str, Any]:
        """Why this term: its F-test among all candidates on the rung below, and what came next."""
        if before is None or rung.term is None:
            return {}
        seen = fit_tests(self.view, before, rules_for(self.view.record))
        own = next((score for score in seen.scores if score.name == rung.term), None)
        rivals = [one for one in _candidates(seen) if one["effect"] != rung.term]
        return {**({} if own is None else _tested(seen, own)), "rivals": rivals[:_RIVALS]}


def _candidates(seen: FitTests) -> list[dict[str, Any]]:
    """The absent terms that could act, most significant first."""
    return [{"effect": score.name, **_tested(seen, score)} for score in seen.scores if score.detectable]


def _tested(seen: FitTests, score: Score) -> dict[str, Any]:
    """F (or chi2 a degree of freedom) of a score, its degrees of freedom, p alone and family-wise."""
    left = seen.fit.dof - score.parameters
    spare = 1.0 if seen.fit.noise_known else max(seen.fit.chi2 - score.delta_chi2, 1e-300) / max(left, 1)
    return {
        "F": score.delta_chi2 / score.parameters / spare,
        "F_dof": [score.parameters, None if seen.fit.noise_known else left],
        "share_of_chi2": score.delta_chi2 / max(seen.fit.chi2, 1e-300),
        "p_single": float(np.exp(score.log_p_single)),
        "p_value": score.p_value,
    }


def _axes(view: ModalProblem, fit: FitResult) -> dict[str, Any]:
    """theta, split, and the four thetas with the fit's effects taken out."""
    out: dict[str, Any] = {name: list(value) for name, value in fit.derived.items()}
    four = view.thetas(fit)
    if four is not None:
        out["four_thetas_deg"] = dict(zip(NAMES, zip(four.theta_deg.tolist(), four.sd_deg.tolist())))
        out["theta_spread_deg"] = four.spread_deg
    return out


def compare_modal(record: ModalRecord, model: Model) -> ModalComparison:
    """Fit ``model`` to a modal record.

    Raises
    ------
    MeasurementError : the record has too few modes, or not those of the plant.
    """
    return ModalComparison(ModalProblem(record, model))


def diagnose_modal(record: ModalRecord, model: Model) -> ModalDiagnosed:
    """Say what ``model`` lacks on a modal record; raises as :func:`compare_modal`."""
    view = ModalProblem(record, model)
    return ModalDiagnosed(view, examine(view, (), rules_for(record)))


def refine_modal(record: ModalRecord, model: Model) -> ModalRefined:
    """Climb from ``model`` on a modal record; raises as :func:`compare_modal`."""
    view = ModalProblem(record, model)
    return ModalRefined(view, forward_selection(view, (), rules_for(record)))
