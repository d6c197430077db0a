"""The ladder of chosen effects: errors as a figure, all numbers as a table."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from bokeh.models import ColumnDataSource, FactorRange, Range1d
from bokeh.models.annotations.geometry import Span
from bokeh.models.ui.ui_element import UIElement

from pipeline.learning.answers import DiagnosisAnswer, RungAnswer
from reports.words.campaign import rung_name
from reports.words.explore_loop import JUDGING, REFUSED
from reports.words.numbers import number, with_sd
from reports.words.quantities import percent

from ..look import AFTER, DRAWN, plot
from ..parts import TILT, legend_above, plain_ticks, show_range, stacked, table, text
from .bench import ChosenModel

_HEADS = ("model", "status", "error, fitted", "held-out", "relative error", "Δχ²", "θ, deg", "split, Hz", "device")

#: Columns that are shown even where they are empty.
_ALWAYS = 6


def statuses(found: ChosenModel, diagnosis: DiagnosisAnswer | None) -> list[str]:
    """The status of each rung: "" for the first; "confirmed" or "partial" where refine accepts the effect, else "refused".

    As in refine, no rung is confirmed below a last model whose misfit stays unexplained.
    """
    rungs = found.refinement.ladder
    if diagnosis is None:
        return ["", *(JUDGING for _ in rungs[1:])]
    explained = diagnosis.verdict not in ("unknown", "fit_failed")
    words = [""]
    for rung, test in zip(rungs[1:], found.judged):
        held = test.held.status == "confirmed" and rung.effect not in found.refinement.wrong_form
        words.append(REFUSED if test.outcome != "accepted" else "confirmed" if held and explained else "partial")
    return words


class LadderPanel:
    """Figure and table; they show whatever was given last."""

    def __init__(self) -> None:
        self.source = ColumnDataSource({"name": [], "fit": [], "held": []})
        self.names = FactorRange()
        self.figure = plot(
            "Error of each model",
            "",
            "error, σ",
            height=300,
            x_range=self.names,
            y_range=Range1d(start=0.1, end=10.0),
            y_axis_type="log",
        )
        self.figure.add_layout(Span(location=1.0, dimension="width", line_color=DRAWN, line_dash="dashed"))
        for column, marker, colour, label in (
            ("fit", "circle", DRAWN, "fitted records"),
            ("held", "square", AFTER, "held-out records"),
        ):
            self.figure.line("name", column, source=self.source, color=colour, line_width=1.5, legend_label=label)
            self.figure.scatter(
                "name", column, source=self.source, marker=marker, size=9, color=colour, legend_label=label
            )
        self.figure.xaxis.major_label_orientation = TILT
        plain_ticks(self.figure)
        legend_above(self.figure)
        self.table = text()

    @property
    def model(self) -> UIElement:
        """What the page shows."""
        return stacked(self.figure, self.table)

    def show(self, rungs: Sequence[RungAnswer], words: Sequence[str]) -> None:
        """Show the models of a ladder and their statuses."""
        names = [f"{k}  {rung_name(rung.effect)}" for k, rung in enumerate(rungs)]
        relative = all(rung.error_fit is None for rung in rungs)
        fit = [rung.relative_error if relative else rung.error_fit for rung in rungs]
        held = [rung.relative_error_validate or None if relative else rung.error_validate for rung in rungs]
        self.names.factors = names
        self.figure.yaxis.axis_label = "relative error" if relative else "error, σ (dashed: noise)"
        self.source.data = {"name": names, "fit": _positive(fit), "held": _positive(held)}
        show_range(
            self.figure.y_range,
            *self.source.data["fit"],
            *self.source.data["held"],
            *([] if relative else [1.0]),
            log=True,
        )
        rows = [_row(rung, word) for rung, word in zip(rungs, words)]
        # Another plant has neither theta nor limits.
        known = [k for k in range(len(_HEADS)) if k < _ALWAYS or any(row[k] for row in rows)]
        self.table.text = table([_HEADS[k] for k in known], [[row[k] for k in known] for row in rows])


def _positive(values: Sequence[float | None]) -> list[float]:
    return [float("nan") if one is None or not np.isfinite(one) or one <= 0.0 else float(one) for one in values]


def _row(rung: RungAnswer, status: str) -> list[str]:
    theta, split = (with_sd(*rung.derived[name]) if name in rung.derived else "" for name in ("theta_deg", "split_hz"))
    return [
        rung_name(rung.effect),
        status,
        number(rung.error_fit),
        number(rung.error_validate),
        "" if rung.relative_error is None else percent(rung.relative_error),
        "" if rung.effect is None else number(rung.delta_chi2, 4),
        theta,
        split,
        rung.verdict or "",
    ]
