"""gyroscreen compare, diagnose, refine for poles and residues: the same three questions."""

from __future__ import annotations

import json as json_
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Literal

from pipeline.device.model import Model
from pipeline.experiment.files.modal_record import ModalRecord
from pipeline.plain import plain

from ..learning.modal_answers import (
    ModalComparison,
    ModalDiagnosed,
    ModalRefined,
    compare_modal,
    diagnose_modal,
    refine_modal,
)
from ..learning.text import verdict_sentence
from .modal_text import modal_text


def answer_modal(
    question: Literal["compare", "diagnose", "refine"],
    record: ModalRecord,
    model: Model,
    out: Path | None,
    folders: Sequence[Path],
    json: bool,
) -> None:
    """Answer one of the three questions to a modal record; print it, and draw its page where ``out`` is given."""
    answers: dict[str, Callable[[ModalRecord, Model], ModalComparison | ModalDiagnosed | ModalRefined]] = {
        "compare": compare_modal,
        "diagnose": diagnose_modal,
        "refine": refine_modal,
    }
    found = answers[question](record, model)
    said = plain(found.to_dict())
    page = None
    if out is not None and said.get("verdict") != "fit_failed" and said.get("fit_ok", True):
        from .learn_pages import modal_page

        page = modal_page(question, record, found.view, said, out, folders)
    if json:
        print(json_.dumps(said))
        return
    print("\n".join(modal_text(question, said)))
    if question != "compare":
        print(verdict_sentence(said["verdict"], said["effects"], said["classes"]))
    if page is not None:
        print(page)
