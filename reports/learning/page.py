"""The page of compare, diagnose and refine, for campaigns and modal records: one HTML file that opens offline.

answers, records --content--> LearningContent --figures, templates--> HTML
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

from msgspec import UNSET

from pipeline.device.effect import Effect
from pipeline.learning.answers import ComparisonAnswer, DiagnosisAnswer, Measured, RefinementAnswer

from ..html.rendering import environment, estimate, stylesheet
from ..limits_origin import LimitsOrigin
from ..words import campaign as words
from ..words import quantities, records
from ..words.limits import given_limits
from ..words.support import support_words
from .content import LearningContent, learning_content
from .figures.decays import decay_pictures
from .figures.ladder import four_thetas_plot, ladder_plot, residue_plot
from .figures.records import record_figures
from .figures.tones import tone_pictures
from .record_view import RecordView
from .tone_view import ToneView

__all__ = ["RecordView", "ToneView", "render_learning_page"]

#: Rows of a table that are shown without a click.
_SHOWN = 10


def render_learning_page(
    name: str,
    comparison: ComparisonAnswer,
    diagnosis: DiagnosisAnswer | None,
    refinement: RefinementAnswer | None,
    *,
    before: Sequence[RecordView] = (),
    after: Sequence[RecordView] | None = None,
    tones: Sequence[ToneView] = (),
    tones_after: Sequence[ToneView] = (),
    library: Mapping[str, Effect],
    limits: LimitsOrigin | None = None,
    truth: str | None = None,
) -> str:
    """The page as HTML text; the same input gives the same page.

    Parameters
    ----------
    name : of the device or of the modal record.
    comparison, diagnosis, refinement : the answers; ``None`` where the question was not asked.  Where both are given,
        ``refinement`` has the verdict and ``diagnosis`` the candidates of the first model.
    before, after : the records with the first and with the last model; none for a modal record.
    tones, tones_after : sweeps and frequency responses with the first and with the last model.
    library : effects by name.
    limits : where the limits that judge the device came from, where they were given.
    truth : the hidden effect, where it is known.
    """
    content = learning_content(name, comparison, diagnosis, refinement, library)
    fitted = {row.name: value[0] for row in content.parameters if (value := row.after or row.before) is not None}
    refused = [name for name in refinement.refused if name not in refinement.not_refitted] if refinement else []
    last = refinement.where or () if refinement else ()
    env = environment()
    # Included templates see the context of the page, but their macros see globals only.
    env.filters["known"] = _known
    env.globals.update(_WORDS, size=lambda key, value: _size(key, value, library))
    return env.get_template("learning.html.j2").render(
        c=content,
        ladder_figure=ladder_plot(content.ladder, refused),
        residues=residue_plot(comparison.where, last),
        four_thetas=four_thetas_plot(content.ladder),
        records=record_figures(
            before,
            after if len(content.ladder) > 1 else None,
            {key: value for key, value in fitted.items() if value is not None},
        ),
        decays=decay_pictures(before, after if len(content.ladder) > 1 else None, modes_of(fitted)),
        tones=tone_pictures(tones, tones_after if len(content.ladder) > 1 else ()),
        stylesheet=stylesheet("learning.css"),
        sections=_sections(content, truth),
        shown=_SHOWN,
        limits="" if limits is None else given_limits(limits),
        truth=truth,
    )


def _size(name: str, value: Measured, library: Mapping[str, Effect]) -> str:
    """ "k3 = value ± sd unit"."""
    unit = quantities.typeset(quantities.unit_of(name, library))
    return f"{quantities.typeset(quantities.symbol_words(name))} = {estimate(value)} {unit}".rstrip()


def modes_of(fitted: Mapping[str, float | None]) -> list[float]:
    """Frequencies [Hz] of the modes of the plant among the fitted parameters."""
    return [value for name, value in fitted.items() if value is not None and re.fullmatch(r"f\d+_hz", name)]


def _known(value: Any) -> Any:
    """``None`` for an answer's field that does not apply."""
    return None if value is UNSET else value


def _chi2_width(delta_chi2: float, largest: float) -> float:
    """Width [px] of the bar of a decrease of chi2, logarithmic from 1; the largest has 70."""
    if not (delta_chi2 > 1.0 and largest > 1.0):
        return 1.0
    return float(min(70.0 * math.log(delta_chi2) / math.log(largest), 70.0))


_WORDS: Mapping[str, Any] = {
    "bad_words": records.BAD_WORDS,
    "support": support_words,
    "change_sentence": words.change_sentence,
    "chi2_width": _chi2_width,
    "effect": words.effect_words,
    "effects_listed": words.effects_listed,
    "error": quantities.error_words,
    "explained": quantities.explained_words,
    "family_words": quantities.family_words,
    "kind_words": quantities.kind_words,
    "listed": quantities.listed,
    "noise_sentence": words.noise_sentence,
    "p_words": quantities.p_words,
    "parameter": words.parameter_words,
    "reason_words": words.reason_words,
    "rung_name": words.rung_name,
    "sentence": words.sentence,
    "separating_sentence": words.separating_sentence,
    "typeset": quantities.typeset,
}


def _sections(content: LearningContent, truth: str | None) -> tuple[tuple[str, str], ...]:
    """Anchor and title of each section of the page."""
    sections = (
        ("ladder", "Ladder", bool(content.ladder)),
        ("where", "Where the model fails", bool(content.comparison.error)),
        ("candidates", "Candidates", bool(content.diagnosis or content.refinement)),
        ("parameters", "Parameters", bool(content.parameters)),
        ("laws", "Effects", bool(content.laws)),
        ("truth", "Hidden effect", bool(truth)),
    )
    return tuple((key, title) for key, title, shown in sections if shown)
