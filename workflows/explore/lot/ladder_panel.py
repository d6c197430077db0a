"""The ladder of chosen irregularities: the forecast of each model beside the measured yield, log scores, errors."""

from __future__ import annotations

from collections.abc import Sequence

from bokeh.models import ColumnDataSource, FactorRange, Range1d
from bokeh.models.annotations.arrows import TeeHead
from bokeh.models.annotations.geometry import Span, Whisker
from bokeh.models.ui.ui_element import UIElement

from pipeline.learning.lot.answers import LotRungAnswer
from reports.words.explore_lot import NO_FORECAST
from reports.words.lot import forecast_words
from reports.words.numbers import number

from ..look import AFTER, DRAWN, Panel, plot
from ..parts import TILT, paragraphs, show_range, stacked, table, text

_HEADS = (
    "model",
    "status",
    "error, fitted",
    "held-out",
    "log score, fitted",
    "held-out",
    "Δ deviance",
    "yield of the held-out wafers",
)


class LotLadderPanel:
    """Two figures and a table; they show whatever was given last."""

    def __init__(self) -> None:
        self.source = ColumnDataSource({"name": [], "mean": [], "low": [], "high": []})
        self.names = FactorRange()
        self.forecast = plot(
            "Forecast yield of each model",
            "",
            "yield, %",
            height=260,
            x_range=self.names,
            y_range=Range1d(start=0.0, end=100.0),
        )
        self.forecast.scatter("name", "mean", source=self.source, size=10, color=AFTER)
        head = TeeHead(size=12, line_color=AFTER, line_width=2)
        self.forecast.add_layout(
            Whisker(
                base="name",
                lower="low",
                upper="high",
                source=self.source,
                line_color=AFTER,
                line_width=2,
                upper_head=head,
                lower_head=head,
            )
        )
        self.measured = Span(dimension="width", line_color=DRAWN, line_dash="dashed", line_width=2)
        self.forecast.add_layout(self.measured)
        self.scores = ColumnDataSource({"name": [], "score": []})
        self.score = plot(
            "Held-out log score of each model",
            "",
            "nats a device",
            height=260,
            x_range=self.names,
            y_range=Range1d(start=0.0, end=1.0),
        )
        self.score.line("name", "score", source=self.scores, color=AFTER, line_width=1.5)
        self.score.scatter("name", "score", source=self.scores, size=9, color=AFTER)
        for drawn in (self.forecast, self.score):
            drawn.xaxis.major_label_orientation = TILT
        self.table = text()
        self.note = text()

    @property
    def panels(self) -> list[Panel]:
        """The panels of the page."""
        return [
            Panel(self.model, "Ladder", wide=True),
            Panel(
                stacked(self.forecast, self.note), "Yield of the held-out wafers",
                "Forecast with its 90 % interval; dashed: measured.",
            ),
            Panel(self.score, "Log score of the held-out wafers", "Higher is better."),
        ]  # fmt: skip

    @property
    def model(self) -> UIElement:
        """The table."""
        return self.table

    def show(self, rungs: Sequence[LotRungAnswer], statuses: Sequence[str]) -> None:
        """Show the models of a ladder and their statuses."""
        names = [f"{k}  {rung.model}" for k, rung in enumerate(rungs)]
        self.names.factors = names
        judged = [(name, rung.forecast) for name, rung in zip(names, rungs) if rung.forecast is not None]
        self.note.text = "" if judged else paragraphs([NO_FORECAST])
        self.source.data = {
            "name": [name for name, _ in judged],
            "mean": [100.0 * one.mean for _, one in judged],
            "low": [100.0 * one.low for _, one in judged],
            "high": [100.0 * one.high for _, one in judged],
        }
        self.measured.location = 100.0 * judged[-1][1].measured if judged else None
        scores = [(name, r.log_score_validate) for name, r in zip(names, rungs) if r.log_score_validate is not None]
        self.scores.data = {"name": [name for name, _ in scores], "score": [one for _, one in scores]}
        show_range(self.score.y_range, [one for _, one in scores], log=False)
        self.table.text = table(_HEADS, [_row(rung, word) for rung, word in zip(rungs, statuses)])


def _row(rung: LotRungAnswer, status: str) -> list[str]:
    return [
        rung.model,
        status,
        number(rung.error_fit),
        number(rung.error_validate),
        number(rung.log_score_fit),
        number(rung.log_score_validate),
        "" if rung.irregularity is None else number(rung.delta_deviance),
        forecast_words(rung.forecast),
    ]
