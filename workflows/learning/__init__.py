"""The learning loop on a campaign or a modal record: compare, diagnose, refine; as short as the commands.

compare(campaign, model)     how good, and where it fails
diagnose(campaign, model)    what is missing, or that nothing of the library is
refine(campaign, model)      add, refit, until nothing more is warranted: the ladder
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, overload

from threadpoolctl import threadpool_limits

from pipeline.criticism.fit_tests import Rules
from pipeline.criticism.ladder import as_ladder
from pipeline.criticism.ladder import diagnose as examine
from pipeline.criticism.selection import forward_selection
from pipeline.device.model import DEFAULT_COMPARE_MODEL, Model
from pipeline.errors import MeasurementError
from pipeline.experiment.files.modal_record import ModalRecord
from pipeline.experiment.noise.level import noise_level
from pipeline.experiment.record import Campaign
from pipeline.learning.campaign.problem import CampaignProblem

from ..machine import worker_count
from .campaign_answers import Comparison, Diagnosed, Refined

if TYPE_CHECKING:
    from .modal_answers import ModalComparison, ModalDiagnosed, ModalRefined

__all__ = ["Comparison", "Diagnosed", "Refined", "compare", "diagnose", "refine", "view_of"]


def view_of(campaign: Campaign, model: Model = DEFAULT_COMPARE_MODEL, threads: int = 0) -> CampaignProblem:
    """The campaign as the loop sees it; ``threads`` (one a usable core where it is 0) take signatures at once.

    Raises
    ------
    MeasurementError : no record to fit.
    """
    if not campaign.with_role("fit"):
        raise MeasurementError(
            "no record to fit", value=campaign.device_id, next_step='give at least one record role = "fit"'
        )
    return CampaignProblem(campaign, model, noise_level(campaign), worker_count(threads))


@overload
def compare(campaign: Campaign, model: Model = ...) -> Comparison: ...
@overload
def compare(campaign: ModalRecord, model: Model = ...) -> ModalComparison: ...
@threadpool_limits.wrap(limits=1)
def compare(campaign: Campaign | ModalRecord, model: Model = DEFAULT_COMPARE_MODEL) -> Comparison | ModalComparison:
    """Fit ``model`` to the fit records and judge it on all."""
    if isinstance(campaign, ModalRecord):
        from .modal_answers import compare_modal

        return compare_modal(campaign, model)
    found = Comparison(view_of(campaign, model))
    found.view.fit(())
    return found


@overload
def diagnose(campaign: Campaign, model: Model = ...) -> Diagnosed: ...
@overload
def diagnose(campaign: ModalRecord, model: Model = ...) -> ModalDiagnosed: ...
@threadpool_limits.wrap(limits=1)
def diagnose(campaign: Campaign | ModalRecord, model: Model = DEFAULT_COMPARE_MODEL) -> Diagnosed | ModalDiagnosed:
    """Say what ``model`` lacks."""
    if isinstance(campaign, ModalRecord):
        from .modal_answers import diagnose_modal

        return diagnose_modal(campaign, model)
    view = view_of(campaign, model)
    rules = Rules()
    if view.noise.source == "local":
        # Held-out records vouch for every term, so there may be as many as in a ladder.
        rules = replace(rules, max_named=rules.rungs)
    return Diagnosed(view, examine(view, rules=rules))


@overload
def refine(campaign: Campaign, model: Model = ...) -> Refined: ...
@overload
def refine(campaign: ModalRecord, model: Model = ...) -> ModalRefined: ...
@threadpool_limits.wrap(limits=1)
def refine(campaign: Campaign | ModalRecord, model: Model = DEFAULT_COMPARE_MODEL) -> Refined | ModalRefined:
    """Climb from ``model`` until nothing more is warranted."""
    if isinstance(campaign, ModalRecord):
        from .modal_answers import refine_modal

        return refine_modal(campaign, model)
    view = view_of(campaign, model)
    selection = forward_selection(view)
    return Refined(view, as_ladder(view, selection), selection)
