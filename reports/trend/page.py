"""The page of a trend: one self-contained HTML file that opens offline."""

from __future__ import annotations

from collections.abc import Mapping

from ..html.rendering import environment, stylesheet
from ..words import trend as words
from .content import InputChange, TrendContent
from .figures import control_charts


def render_trend(content: TrendContent) -> str:
    """The page as HTML text; the same content gives the same page."""
    charts = [chart for chart in content.charts if chart.points]
    return (
        environment()
        .get_template("trend.html.j2")
        .render(
            c=content,
            stylesheet=stylesheet(),
            figures={"control-charts": control_charts(charts, content.run_id)} if charts else {},
            charts=charts,
            judged=[chart for chart in charts if chart.tonight.run_id == content.run_id],
            words=words,
            groups=_grouped(content),
        )
    )


def _grouped(content: TrendContent) -> Mapping[str, tuple[InputChange, ...]]:
    """The changes by group, in order; groups without changes are left out."""
    found = {name: tuple(one for one in content.changes if one.what == what) for what, name in words.GROUPS.items()}
    return {name: rows for name, rows in found.items() if rows}
