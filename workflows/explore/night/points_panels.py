"""Wafer map and scatter plot: the same devices, drawn from one source, so that a selection in one is one in the other."""

from __future__ import annotations

from typing import Any

import numpy as np
from bokeh.models.sources import ColumnDataSource
from bokeh.models.widgets.inputs import Select
from bokeh.models.widgets.markups import Div

from pipeline.arrays import FloatArray, IntArray
from reports.words import explore as words

from . import figures as draw
from . import markup
from .limits_panel import quantities
from .preview import VERDICTS
from .state import NightState


class PointsPanels:
    """Both figures, the choice of the wafer, of the colour and of the two quantities, and a remark on the selection."""

    def __init__(self, state: NightState) -> None:
        self.state = state
        names, night = quantities(state), state.night
        options = [(name, words.quantity_words(name)) for name in names]
        wide: dict[str, Any] = {"sizing_mode": "stretch_width"}
        lots = sorted({name for name in night.devices.text("lot").counts() if name})
        groups = dict.fromkeys([("", words.ALL_WAFERS), *[(name, name) for name in (*lots, *night.wafer_names)]])
        self.wafer = Select(title="Wafer or lot", options=list(groups), value="", **wide)
        colours = [("verdict", words.VERDICT), ("p_pass", words.P_CONFORM), *options]
        self.colour = Select(title="Colour", options=colours, value="verdict", **wide)
        x, y = [*(name for name in ("theta_deg", "split_hz") if name in names), *names, "", ""][:2]
        self.x, self.y = (
            Select(title=title, options=options, value=value, **wide) for title, value in zip("xy", (x, y))
        )
        self.drawn, self.remark = Div(text="", **wide), Div(text="", **wide)
        self.points = ColumnDataSource({name: [] for name in ("id", "mx", "my", "x", "y", "c", "verdict")})
        self.rows: IntArray = np.zeros(0, dtype=np.int64)
        self.map = draw.wafer_map(self.points)
        self.pair = draw.scatter(self.points)
        self.wafer.on_change("value", state.then(self.choose))
        for select in (self.colour, self.x, self.y):
            select.on_change("value", state.then(self.draw))
        self.points.selected.on_change("indices", state.then(self._selected))
        state.follow("judged", self.judged)
        state.follow("selection", self.mark)
        self.choose()

    def choose(self) -> None:
        """Show the devices of another wafer or lot."""
        night, state = self.state.night, self.state
        state.wafer, state.selected = self.wafer.value, np.zeros(0, dtype=np.int64)
        rows = np.flatnonzero(night.on(state.wafer))
        self.rows = rows[:: max(1, -(-rows.size // draw.POINTS))]
        found = draw.places(night, state.wafer)
        self.map.outlines.data = draw.outlines_of(found)
        known = np.isfinite(found.x[rows]).any()
        shown = words.shown_sentence(self.rows.size, rows.size) if known else words.NO_DIES
        self.drawn.text = markup.note_html(shown)
        empty = np.zeros(self.rows.size)
        self.points.data = {
            "id": [night.device_ids[row] for row in self.rows],
            "mx": found.x[self.rows],
            "my": found.y[self.rows],
            "x": empty,
            "y": empty,
            "c": empty,
            "verdict": self._verdicts(),
        }
        self.draw()
        state.tell("wafer", "selection")

    def judged(self) -> None:
        """Colours by the verdicts as they are now."""
        self.points.data = {**self.points.data, "verdict": self._verdicts()}
        if self.colour.value == "p_pass":
            self.draw()
        self.mark()

    def _verdicts(self) -> list[str]:
        return [VERDICTS[code] for code in self.state.judged.codes[self.rows].tolist()]

    def draw(self) -> None:
        """Positions in the scatter plot and colours of the map."""
        night, rows, by = self.state.night, self.rows, self.colour.value
        x, y = (night.value(name.value)[rows] for name in (self.x, self.y))
        colour = np.zeros(rows.size)
        if by != "verdict":
            colour = (self.state.judged.p_pass if by == "p_pass" else night.value(by))[rows]
            self.map.scale.low, self.map.scale.high = (0.0, 1.0) if by == "p_pass" else _central(colour)
            self.map.bar.title = words.P_CONFORM if by == "p_pass" else words.quantity_words(by)
        self.map.verdicts.visible = self.map.figure.legend.visible = by == "verdict"
        self.map.numbers.visible = self.map.bar.visible = by != "verdict"
        draw.axis_words(self.pair, self.x.value, self.y.value)
        self.points.data = {**self.points.data, "x": x, "y": y, "c": colour}

    def _selected(self) -> None:
        """Devices were selected in a figure."""
        self.state.selected = self.rows[np.asarray(self.points.selected.indices, dtype=np.int64)]
        if self.state.selected.size == 1:
            self.state.device = int(self.state.selected[0])
            self.state.tell("device")
        self.state.tell("selection")

    def mark(self) -> None:
        """The selected devices, and how many there are."""
        chosen = self.state.selected
        # Both are in order, and the drawn devices may be some of them only.
        places = np.flatnonzero(np.isin(self.rows, chosen)).tolist()
        if places != self.points.selected.indices:
            self.state.quietly(lambda: setattr(self.points.selected, "indices", places))
        passed = int(np.sum(self.state.judged.codes[chosen] == VERDICTS.index("pass")))
        self.remark.text = markup.note_html(words.selected_sentence(chosen.size, passed))


def _central(values: FloatArray) -> tuple[float, float]:
    """The central 96 % of the known values."""
    known = values[np.isfinite(values)]
    if not known.size:
        return 0.0, 1.0
    low, high = np.quantile(known, [0.02, 0.98])
    return float(low), float(high if high > low else low + 1.0)
