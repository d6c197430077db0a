"""The section "Where the loss comes from" of a run's page: the bars and the table, from an attribution."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ..attribution.content import LOSS, Attribution
from ..html.style import Drawing
from ..interval_estimate import IntervalEstimate
from ..words.attribution import METHOD, UNDETERMINED, source_words, verdict_words
from ..words.quantities import label, percent
from ..yields import clopper_pearson
from .figures.sources import SourceBar, tornado

#: Bars of the figure: the others are together below the width of a line.
MOST_BARS = 14


@dataclass(frozen=True)
class LossSources:
    """Content of the section.

    Parameters
    ----------
    figure : the bars; ``None`` where nothing or everything is lost.
    summary, verdicts, method : sentences.
    columns : limited quantities whose loss the table has.
    rows : name of a source, its share of the loss to each limit in percent with the half of its 95 % interval.
    """

    figure: Drawing | None
    summary: str
    verdicts: str
    method: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, tuple[str, ...]], ...]


def loss_sources(found: Attribution) -> LossSources:
    """The section of an attribution."""
    loss = found.loss()
    shown = loss.shares[:MOST_BARS]
    bars = [
        SourceBar(source_words(s.source), s.source.level, _span(s.share), None if s.halved is None else _span(s.halved))
        for s in shown
    ]
    by_limit = [one for one in found.process if one.output.startswith(f"{LOSS}:")]
    tables = [{s.source: s.share for s in one.shares} for one in by_limit]
    rows = tuple(
        (
            source_words(s.source),
            tuple(_cell(table.get(s.source)) for table in tables),
        )
        for s in shown
    )
    spread = clopper_pearson(round(loss.mean * found.samples), found.samples)
    others = sum(s.share.value for s in loss.shares[MOST_BARS:])
    summary = (
        f"{percent(loss.mean)} (95 % interval {percent(spread.low)} to {percent(spread.high)}) of the devices of the population"
        f" are truly lost, from {found.samples} draws, each of a lot of its own."
        f" {len(loss.shares[MOST_BARS:])} further sources together have {percent(others)}."
        if loss.shares
        else f"Of {found.samples} devices drawn from the population none or all are truly lost: there is nothing to attribute."
    )
    return LossSources(
        tornado(bars) if bars else None,
        summary,
        verdict_words(found.verdicts),
        METHOD,
        tuple(f"{label(one.output.split(':')[1])} ({percent(one.mean)})" for one in by_limit),
        rows,
    )


def _span(found: IntervalEstimate) -> tuple[float, float, float]:
    return found.value, found.low, found.high


def _cell(share: IntervalEstimate | None) -> str:
    """A share in percent; a dash where it is not determined."""
    if share is None or not math.isfinite(share.value) or share.sd > UNDETERMINED:
        return "–"
    return f"{100.0 * max(share.value, 0.0):.0f} ± {50.0 * (share.high - share.low):.0f}"
