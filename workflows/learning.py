"""The learning loop on a campaign or a modal record: compare, diagnose, refine; as short as the commands.

compare(campaign, model)     how good, and where it fails
diagnose(campaign, model)    what is missing, or that nothing of the library is
refine(campaign, model)      add, refit, until nothing more is warranted: the ladder
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, overload

from pipeline.criticism.loop import Diagnosis
from pipeline.criticism.loop import diagnose as examine
from pipeline.criticism.loop import refine as climb
from pipeline.criticism.regions import where
from pipeline.device.model import DEFAULT_COMPARE_MODEL, Model
from pipeline.errors import MeasurementError
from pipeline.experiment.modal_record import ModalRecord
from pipeline.experiment.noise_level import noise_level
from pipeline.experiment.record import Campaign
from pipeline.inference.campaign_fit import CampaignFit

from .campaign_view import CampaignView
from .modal_learning import ModalComparison, ModalDiagnosed, ModalRefined, compare_modal, diagnose_modal, refine_modal

_SHOWN = 12


def view_of(campaign: Campaign, model: Model = DEFAULT_COMPARE_MODEL) -> CampaignView:
    """The campaign as the loop sees it.

    Raises
    ------
    MeasurementError : no record to fit.
    """
    if not campaign.with_role("fit"):
        raise MeasurementError(
            "no record to fit", value=campaign.device_id, next_step='give at least one record role = "fit"'
        )
    return CampaignView(campaign, model, noise_level(campaign))


@dataclass(frozen=True, eq=False)
class Comparison:
    """How well a model explains a campaign, and where it does not."""

    view: CampaignView

    @cached_property
    def fit(self) -> CampaignFit:
        """The fit behind it."""
        self.view.fit(())
        return self.view.campaign_fit(())

    def to_dict(self) -> dict[str, Any]:
        """As plain JSON, DESIGN's keys."""
        result = self.view.fit(())
        if not result.ok:
            return {
                "error": {},
                "relative_error": {},
                "where": [],
                "parameters": {},
                "fit_ok": False,
                "why": result.why,
            }
        fit = self.fit
        known = fit.noise.source != "local"
        found = where(self.view.regions(result))
        return {
            "error": {k: v if known else None for k, v in fit.error.items()},
            "relative_error": dict(fit.relative_error),
            "misfit": {k: v if known else None for k, v in fit.misfit.items()},
            "noise": {
                "sigma": [float(s) for s in fit.noise.sigma_v],
                "from": "residual" if not known else fit.noise.source,
            },
            "where": [
                {**w.labels, "kind": _kind(w.family), "share": w.share, "error": w.error} for w in found[:_SHOWN]
            ],
            "records": {r.name: {"role": r.role, "error": r.error if known else None} for r in fit.records},
            "parameters": {name: list(value) for name, value in fit.parameters.items()},
            "fit_ok": fit.fit_ok,
        }


def _kind(family: str) -> str:
    return {"frequency": "resonance"}.get(family, family)


@dataclass(frozen=True, eq=False)
class Diagnosed:
    """What a model lacks on a campaign."""

    view: CampaignView
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
        """As plain JSON, DESIGN's keys."""
        return {"separating_record": None, **self.diagnosis.to_dict()}


@dataclass(frozen=True, eq=False)
class Refined:
    """The ladder of a campaign, with theta and split before and after."""

    view: CampaignView
    ladder: Any

    @property
    def verdict(self) -> str:
        """That of the last rung."""
        return str(self.ladder.verdict)

    @property
    def effects(self) -> tuple[str, ...]:
        """Effects that were added."""
        return tuple(self.ladder.terms)

    @property
    def classes(self) -> tuple[tuple[str, ...], ...]:
        """Classes of more than one member."""
        return tuple(tuple(c.members) for c in self.ladder.classes if len(c.members) > 1)

    @property
    def before(self) -> CampaignFit:
        """The fit that the climb began with."""
        return self.view.campaign_fit(())

    @property
    def after(self) -> CampaignFit:
        """The fit that it ended with."""
        return self.view.campaign_fit(self.effects)

    def to_dict(self) -> dict[str, Any]:
        """As plain JSON, DESIGN's keys."""
        out: dict[str, Any] = self.ladder.to_dict()
        if self.verdict == "fit_failed":
            return out
        for key, fit in (("before_", self.before), ("", self.after)):
            if fit.theta_deg is not None and fit.split_hz is not None:
                out[f"theta_{key}deg"] = list(fit.theta_deg)
                out[f"split_{key}hz"] = list(fit.split_hz)
        out["parameters"] = {name: list(value) for name, value in self.after.parameters.items()}
        return out


@overload
def compare(campaign: Campaign, model: Model = ...) -> Comparison: ...
@overload
def compare(campaign: ModalRecord, model: Model = ...) -> ModalComparison: ...
def compare(campaign: Campaign | ModalRecord, model: Model = DEFAULT_COMPARE_MODEL) -> Comparison | ModalComparison:
    """Fit ``model`` to the fit records and judge it on all."""
    if isinstance(campaign, ModalRecord):
        return compare_modal(campaign, model)
    found = Comparison(view_of(campaign, model))
    found.view.fit(())
    return found


@overload
def diagnose(campaign: Campaign, model: Model = ...) -> Diagnosed: ...
@overload
def diagnose(campaign: ModalRecord, model: Model = ...) -> ModalDiagnosed: ...
def diagnose(campaign: Campaign | ModalRecord, model: Model = DEFAULT_COMPARE_MODEL) -> Diagnosed | ModalDiagnosed:
    """Say what ``model`` lacks."""
    if isinstance(campaign, ModalRecord):
        return diagnose_modal(campaign, model)
    view = view_of(campaign, model)
    return Diagnosed(view, examine(view))


@overload
def refine(campaign: Campaign, model: Model = ...) -> Refined: ...
@overload
def refine(campaign: ModalRecord, model: Model = ...) -> ModalRefined: ...
def refine(campaign: Campaign | ModalRecord, model: Model = DEFAULT_COMPARE_MODEL) -> Refined | ModalRefined:
    """Climb from ``model`` until nothing more is warranted."""
    if isinstance(campaign, ModalRecord):
        return refine_modal(campaign, model)
    view = view_of(campaign, model)
    return Refined(view, climb(view))
