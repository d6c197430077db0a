"""gyroscreen compare, diagnose, refine, demo."""

from __future__ import annotations

import json as json_
import math
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from threadpoolctl import threadpool_limits

from pipeline.device.effect import find_effects
from pipeline.device.model import DEFAULT_COMPARE_MODEL, Model, load_model
from pipeline.errors import UsageError
from pipeline.experiment.campaign import read_measurement
from pipeline.experiment.modal_record import ModalRecord
from pipeline.experiment.record import Campaign
from pipeline.inference.campaign_fit import CampaignFit
from reports.campaign_page import RecordView, effect_texts, render_campaign_report
from reports.modal_page import render_modal_report

from .. import learning
from ..demo import hidden_device
from ..learning_text import verdict_sentence
from ..modal_learning import (
    ModalComparison,
    ModalDiagnosed,
    ModalRefined,
    compare_modal,
    diagnose_modal,
    refine_modal,
)
from ..separating import Proposal
from .modal_text import modal_text


def _fitted(found: Campaign) -> Campaign:
    """The campaign; one without a record to fit fits them all."""
    if found.with_role("fit"):
        return found
    return replace(found, records=tuple(replace(r, role="fit") for r in found.records))


def _model(path: Path | None, folders: Sequence[Path]) -> Model:
    model = load_model(path) if path is not None else DEFAULT_COMPARE_MODEL
    known = (*model.effect_folders, *(str(folder) for folder in folders))
    return model if known == model.effect_folders else replace(model, effect_folders=tuple(dict.fromkeys(known)))


def plain(value: Any) -> Any:
    """``value`` as JSON can hold it: arrays as lists, nan and infinity as null."""
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    return None if isinstance(value, float) and not math.isfinite(value) else value


def views(campaign: Campaign, fit: CampaignFit) -> tuple[RecordView, ...]:
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


def _page(out: Path | None, name: str, page: str) -> Path | None:
    if out is None:
        return None
    try:
        out.mkdir(parents=True, exist_ok=True)
        (out / name).write_text(page, encoding="utf-8")
    except OSError as error:
        raise UsageError(f"cannot write the page ({error.strerror})", value=str(out)) from None
    return out / name


def _drive_files(found: Sequence[Proposal], out: Path | None) -> None:
    """The records that would separate classes, ready to be played."""
    if out is not None:
        for proposal in found:
            proposal.write(out)


@threadpool_limits.wrap(limits=1)
def compare(path: Path, model: Path | None, out: Path | None, folders: Sequence[Path], json: bool) -> None:
    """See ``gyroscreen compare --help``."""
    measured, base = read_measurement(path), _model(model, folders)
    if isinstance(measured, ModalRecord):
        _modal("compare", measured, base, out, folders, json)
        return
    campaign = _fitted(measured)
    found = learning.compare(campaign, base)
    said = plain(found.to_dict())
    texts = effect_texts(find_effects(tuple(folders)))
    where = None
    if said["fit_ok"] or said["error"]:
        before = views(campaign, found.fit)
        page = render_campaign_report(campaign.device_id, said, None, None, before, None, library=texts)
        where = _page(out, "compare.html", page)
    if json:
        print(json_.dumps(said))
        return
    print(found)
    if where is not None:
        print(where)


@threadpool_limits.wrap(limits=1)
def diagnose(path: Path, model: Path | None, out: Path | None, folders: Sequence[Path], json: bool) -> None:
    """See ``gyroscreen diagnose --help``."""
    measured, base = read_measurement(path), _model(model, folders)
    if isinstance(measured, ModalRecord):
        _modal("diagnose", measured, base, out, folders, json)
        return
    campaign = _fitted(measured)
    found = replace(learning.diagnose(campaign, base), drive_files=out is not None)
    said = plain(found.to_dict())
    _drive_files(found.separating, out)
    if out is not None and found.verdict != "fit_failed":
        first = learning.Comparison(found.view)
        page = render_campaign_report(
            campaign.device_id,
            plain(first.to_dict()),
            said,
            None,
            views(campaign, first.fit),
            None,
            library=effect_texts(find_effects(tuple(folders))),
        )
        _page(out, "diagnose.html", page)
    if json:
        print(json_.dumps(said))
        return
    print(found)


def _modal(
    question: Literal["compare", "diagnose", "refine"],
    record: ModalRecord,
    model: Model,
    out: Path | None,
    folders: Sequence[Path],
    json: bool,
) -> None:
    """The same three questions to poles and residues."""
    answers: dict[str, Callable[[ModalRecord, Model], ModalComparison | ModalDiagnosed | ModalRefined]] = {
        "compare": compare_modal,
        "diagnose": diagnose_modal,
        "refine": refine_modal,
    }
    found = answers[question](record, model)
    said = plain(found.to_dict())
    page = None
    if out is not None and said.get("verdict") != "fit_failed" and said.get("fit_ok", True):
        first = plain(ModalComparison(found.view).to_dict())
        texts = effect_texts(find_effects(tuple(folders)))
        told = {"compare": (None, None), "diagnose": (said, None), "refine": (None, said)}[question]
        name = {"refine": "ladder"}.get(question, question)
        page = _page(out, f"{name}.html", render_modal_report(record.name, first, *told, library=texts))
    if json:
        print(json_.dumps(said))
        return
    print("\n".join(modal_text(question, said)))
    if question != "compare":
        print(verdict_sentence(said["verdict"], said["effects"], said["classes"]))
    if page is not None:
        print(page)


@threadpool_limits.wrap(limits=1)
def refine(path: Path, model: Path | None, out: Path | None, folders: Sequence[Path], json: bool) -> None:
    """See ``gyroscreen refine --help``."""
    measured, base = read_measurement(path), _model(model, folders)
    if isinstance(measured, ModalRecord):
        _modal("refine", measured, base, out, folders, json)
        return
    campaign = _fitted(measured)
    found = replace(learning.refine(campaign, base), drive_files=out is not None)
    said = plain(found.to_dict())
    _drive_files(found.separating, out)
    page = _ladder_page(campaign, found, said, out, folders, None)
    if json:
        print(json_.dumps(said))
        return
    print(found)
    if page is not None:
        print(page)


def _ladder_page(
    campaign: Campaign,
    found: learning.Refined,
    said: Mapping[str, Any],
    out: Path | None,
    folders: Sequence[Path],
    truth: str | None,
) -> Path | None:
    if out is None or found.verdict == "fit_failed":
        return None
    first = learning.Comparison(found.view)
    page = render_campaign_report(
        campaign.device_id,
        plain(first.to_dict()),
        plain(found.first_look),
        said,
        views(campaign, found.before),
        views(campaign, found.after),
        library=effect_texts(find_effects(tuple(folders))),
        truth=truth,
    )
    return _page(out, "ladder.html", page)


@threadpool_limits.wrap(limits=1)
def demo(out: Path, seed: int | None) -> None:
    """See ``gyroscreen demo --help``."""
    began = time.monotonic()
    chosen = int(time.time()) % 100_000 if seed is None else seed
    made = hidden_device(chosen)
    print(f"a virtual device was measured (seed {chosen}); something is hidden in it. Looking ...", file=sys.stderr)
    found = learning.refine(made.campaign)
    said = plain(found.to_dict())
    print(found)
    hidden = ", ".join(f"{k} = {v:.4g}" for k, v in made.parameters.items() if k not in DEFAULT_COMPARE_MODEL.by_name)
    truth = f"{', '.join(made.model.effects)} ({hidden})"
    print(f"the truth: {truth}")
    page = _ladder_page(made.campaign, found, said, out, (), truth)
    print(f"{page}  ({time.monotonic() - began:.0f} s)")
