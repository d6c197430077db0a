"""The pages of compare, diagnose and refine, written where ``--out`` asks for them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from pipeline.device.effect import Effect, find_effects
from pipeline.errors import UsageError
from pipeline.experiment.files.modal_record import ModalRecord
from pipeline.experiment.record import Campaign
from pipeline.inference.general.fit import CampaignFit
from pipeline.learning.modal.problem import ModalProblem
from pipeline.plain import plain
from reports.learning.page import RecordView, effect_texts, render_campaign_report, render_modal_report

from .. import learning
from ..learning.modal_answers import ModalComparison

Library = Mapping[str, Effect]


def _views(campaign: Campaign, fit: CampaignFit) -> tuple[RecordView, ...]:
    """Each driven record as the fit explains it."""
    records = {record.name: record for record in campaign.records}
    return tuple(
        RecordView(
            r.name,
            str(r.role),
            records[r.name].sample_rate_hz,
            records[r.name].drive_v,
            records[r.name].sense_v,
            r.predicted_v,
            r.residual,
            r.error,
        )
        for r in fit.records
    )


def _library(folders: Sequence[Path]) -> Library:
    return effect_texts(find_effects(tuple(folders)))


def _written(out: Path, name: str, page: str) -> Path:
    try:
        out.mkdir(parents=True, exist_ok=True)
        (out / name).write_text(page, encoding="utf-8")
    except OSError as error:
        raise UsageError(f"cannot write the page ({error.strerror})", value=str(out)) from None
    return out / name


def comparison_page(campaign: Campaign, found: learning.Comparison, out: Path, folders: Sequence[Path]) -> Path:
    """Where the model fails.

    Raises
    ------
    UsageError : the folder cannot be written.
    """
    said, before = plain(found.to_dict()), _views(campaign, found.fit)
    page = render_campaign_report(campaign.device_id, said, None, None, before, None, library=_library(folders))
    return _written(out, "compare.html", page)


def diagnosis_page(campaign: Campaign, found: learning.Diagnosed, out: Path, folders: Sequence[Path]) -> Path:
    """What the model lacks; raises as :func:`comparison_page`."""
    first = learning.Comparison(found.view)
    before, said = plain(first.to_dict()), plain(found.to_dict())
    views, library = _views(campaign, first.fit), _library(folders)
    page = render_campaign_report(campaign.device_id, before, said, None, views, None, library=library)
    return _written(out, "diagnose.html", page)


def ladder_page(
    campaign: Campaign, found: learning.Refined, out: Path, folders: Sequence[Path], truth: str | None = None
) -> Path:
    """The ladder, and the truth where it is known; raises as :func:`comparison_page`."""
    page = render_campaign_report(
        campaign.device_id,
        plain(learning.Comparison(found.view).to_dict()),
        plain(found.first_look),
        plain(found.to_dict()),
        _views(campaign, found.before),
        _views(campaign, found.after),
        library=_library(folders),
        truth=truth,
    )
    return _written(out, "ladder.html", page)


def modal_page(
    question: Literal["compare", "diagnose", "refine"],
    record: ModalRecord,
    view: ModalProblem,
    said: Mapping[str, Any],
    out: Path,
    folders: Sequence[Path],
) -> Path:
    """What the same question finds in poles and residues; raises as :func:`comparison_page`."""
    first = plain(ModalComparison(view).to_dict())
    told = {"compare": (None, None), "diagnose": (said, None), "refine": (None, said)}[question]
    name = {"refine": "ladder"}.get(question, question)
    return _written(out, f"{name}.html", render_modal_report(record.name, first, *told, library=_library(folders)))
