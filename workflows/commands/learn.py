"""gyroscreen compare, diagnose, refine, demo; pages are drawn by ``learn_pages``, which takes long to load."""

from __future__ import annotations

import json as json_
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from threadpoolctl import threadpool_limits

from pipeline.device.model import DEFAULT_COMPARE_MODEL, Model, load_model
from pipeline.experiment.campaign import read_measurement
from pipeline.experiment.files.modal_record import ModalRecord
from pipeline.experiment.record import Campaign
from pipeline.learning.next_experiment.separating import Proposal
from pipeline.plain import plain

from .. import learning


def _fitted(found: Campaign) -> Campaign:
    """The campaign; one without a record to fit fits them all."""
    if found.with_role("fit"):
        return found
    return replace(found, records=tuple(replace(r, role="fit") for r in found.records))


def _model(path: Path | None, folders: Sequence[Path]) -> Model:
    model = load_model(path) if path is not None else DEFAULT_COMPARE_MODEL
    known = (*model.effect_folders, *(str(folder) for folder in folders))
    return model if known == model.effect_folders else replace(model, effect_folders=tuple(dict.fromkeys(known)))


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
        from .learn_modal import answer_modal

        answer_modal("compare", measured, base, out, folders, json)
        return
    campaign = _fitted(measured)
    found = learning.compare(campaign, base)
    said = plain(found.to_dict())
    where = None
    if out is not None and (said["fit_ok"] or said["error"]):
        from .learn_pages import comparison_page

        where = comparison_page(campaign, found, out, folders)
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
        from .learn_modal import answer_modal

        answer_modal("diagnose", measured, base, out, folders, json)
        return
    campaign = _fitted(measured)
    found = replace(learning.diagnose(campaign, base), drive_files=out is not None)
    said = plain(found.to_dict())
    _drive_files(found.separating, out)
    if out is not None and found.verdict != "fit_failed":
        from .learn_pages import diagnosis_page

        diagnosis_page(campaign, found, out, folders)
    if json:
        print(json_.dumps(said))
        return
    print(found)


@threadpool_limits.wrap(limits=1)
def refine(path: Path, model: Path | None, out: Path | None, folders: Sequence[Path], json: bool) -> None:
    """See ``gyroscreen refine --help``."""
    measured, base = read_measurement(path), _model(model, folders)
    if isinstance(measured, ModalRecord):
        from .learn_modal import answer_modal

        answer_modal("refine", measured, base, out, folders, json)
        return
    campaign = _fitted(measured)
    found = replace(learning.refine(campaign, base), drive_files=out is not None)
    said = plain(found.to_dict())
    _drive_files(found.separating, out)
    page = None
    if out is not None and found.verdict != "fit_failed":
        from .learn_pages import ladder_page

        page = ladder_page(campaign, found, out, folders)
    if json:
        print(json_.dumps(said))
        return
    print(found)
    if page is not None:
        print(page)


@threadpool_limits.wrap(limits=1)
def demo(out: Path, seed: int | None) -> None:
    """See ``gyroscreen demo --help``."""
    from ..learning.demo import hidden_device
    from .learn_pages import ladder_page

    began = time.monotonic()
    chosen = int(time.time()) % 100_000 if seed is None else seed
    made = hidden_device(chosen)
    print(f"a virtual device was measured (seed {chosen}); something is hidden in it. Looking ...", file=sys.stderr)
    found = learning.refine(made.campaign)
    print(found)
    hidden = ", ".join(f"{k} = {v:.4g}" for k, v in made.parameters.items() if k not in DEFAULT_COMPARE_MODEL.by_name)
    truth = f"{', '.join(made.model.effects)} ({hidden})"
    print(f"the truth: {truth}")
    page = ladder_page(made.campaign, found, out, (), truth)
    print(f"{page}  ({time.monotonic() - began:.0f} s)")
