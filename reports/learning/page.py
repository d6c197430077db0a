"""The page of a campaign: one self-contained HTML file that opens offline.

compare, diagnose, refine, records --content--> CampaignContent --figures, templates--> HTML
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from pipeline.device.effect import Effect, find_effects

from ..html.rendering import environment, measured, number, stylesheet
from ..words.campaign import (
    effect_words,
    error_words,
    explained_words,
    family_words,
    kind_words,
    listed,
    p_words,
    quantity_words,
    sentence,
    typeset,
)
from ..words.quantities import SUPERSCRIPT
from .content import CampaignContent, campaign_content
from .figures import CampaignFigures, campaign_figures
from .record_view import RecordView
from .rows import Value, parameter_label, short_name

__all__ = ["RecordView", "effect_texts", "render_campaign_report"]

#: Rows of a table that are shown without a click.
_SHOWN = 10


def render_campaign_report(
    device_id: str,
    compare: Mapping[str, Any],
    diagnose: Mapping[str, Any] | None,
    refine: Mapping[str, Any] | None,
    before: Sequence[RecordView],
    after: Sequence[RecordView] | None,
    *,
    library: Mapping[str, Mapping[str, str]] | None = None,
    verdicts: Mapping[str, str] | None = None,
    truth: str | None = None,
    provenance: Mapping[str, Any] | None = None,
) -> str:
    """The page of a campaign as HTML text; the same input gives the same page.

    Parameters
    ----------
    device_id : of the campaign.
    compare, diagnose, refine : JSON of the three commands; absent keys leave out what they would have shown.
    before, after : the records as the first and the last model explain them; none for a modal record.
    library : effect -> law, signature, source, and units under "unit.<parameter>" (:func:`effect_texts`); what it does
        not hold is taken from the library of the project.
    verdicts : "before" and "after" of the decision.
    truth : what was hidden, where somebody knows; shown at the end.
    provenance : shown as it is; nested tables become dotted names.
    """
    texts = {**effect_texts(find_effects())}
    for name, entry in (library or {}).items():
        texts[name] = {**texts.get(name, {}), **entry}
    content = campaign_content(
        device_id, compare, diagnose, refine, library=texts, verdicts=verdicts, truth=truth, provenance=provenance
    )
    selection = any(one.effect and one.status != "refused" for one in content.rungs)
    figures = campaign_figures(content, before, after if selection or not content.rungs else None)
    env = environment()
    env.filters["effect_name"] = effect_words
    # Templates that are included see what the page was given, but their macros see globals only.
    env.globals.update(
        effect=effect_words,
        error=error_words,
        sized=_sized,
        short=short_name,
        typeset=typeset,
        sentence=sentence,
        explained=explained_words,
        p_words=p_words,
        chi2_width=_chi2_width,
        listed=listed,
        kind_words=kind_words,
        family_words=family_words,
        quantities=quantity_words,
    )
    return env.get_template("campaign.html.j2").render(
        c=content,
        f=figures,
        stylesheet=stylesheet("campaign.css"),
        sections=_sections(content, figures),
        shown=_SHOWN,
        parameter=parameter_label,
    )


def _sized(value: Value) -> str:
    """value ± sd in one piece; far from 1 in brackets before a power of ten."""
    return _estimate(value).replace(" ", "\u00a0")


def _estimate(value: Value) -> str:
    largest = max(abs(value.value), value.sd if value.sd > 0.0 else 0.0)
    if 1e-2 <= largest < 1e5 or largest == 0.0:
        return measured(value.value, value.sd) if value.sd > 0.0 else number(value.value, 6)
    exponent = math.floor(math.log10(largest))
    power = f"10{str(exponent).translate(SUPERSCRIPT)}"
    if not value.sd > 0.0:
        return f"{number(value.value / 10.0**exponent, 4)}·{power}"
    return f"({measured(value.value / 10.0**exponent, value.sd / 10.0**exponent)})·{power}"


def _chi2_width(fall: float, widest: float) -> float:
    """Width [px] of the bar of a fall of chi2, logarithmic from 1."""
    if not (fall > 1.0 and widest > 1.0):
        return 1.0
    return float(min(100.0 * math.log(fall) / math.log(widest), 100.0))


def effect_texts(effects: Mapping[str, Effect]) -> dict[str, dict[str, str]]:
    """Law, signature and source of effects in words, and the unit of each parameter under "unit.<parameter>"."""
    return {
        name: {
            "law": effect.law,
            "signature": effect.signature,
            "source": effect.source,
            **{f"unit.{parameter.name}": parameter.unit for parameter in effect.parameters},
        }
        for name, effect in effects.items()
    }


def _sections(content: CampaignContent, figures: CampaignFigures) -> tuple[tuple[str, str], ...]:
    return tuple(
        (key, name)
        for key, name, there in (
            ("ladder", "Ladder", bool(content.rungs)),
            ("where", "Where it fails", bool(content.regions or figures.channels)),
            ("candidates", "Candidates", bool(content.candidates)),
            ("parameters", "Parameters", bool(content.parameters)),
            ("laws", "The physics", bool(content.laws)),
            ("truth", "The truth", bool(content.truth)),
            ("provenance", "Provenance", bool(content.provenance)),
        )
        if there
    )
