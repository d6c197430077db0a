"""The page of a gauge R&R: one self-contained HTML file that opens offline."""

from __future__ import annotations

from ..html.rendering import environment, stylesheet
from ..words import gauge as words
from ..words.limits import origin_sentence
from .content import GaugeContent
from .figures import gauge_figure


def render_gauge(content: GaugeContent) -> str:
    """The page as HTML text; the same content gives the same page."""
    figures = {
        chart.study.quantity: gauge_figure(chart, f"gauge-{k}") for k, chart in enumerate(content.charts, start=1)
    }
    return (
        environment()
        .get_template("gauge.html.j2")
        .render(
            c=content,
            stylesheet=stylesheet(),
            figures=figures,
            words=words,
            headline=words.headline([chart.study for chart in content.charts]),
            origin=origin_sentence(content.limits),
        )
    )
