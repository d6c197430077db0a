"""The distribution of a quantity with its limits, which move by the mouse or by the keyboard."""

from __future__ import annotations

import math
from time import perf_counter
from typing import Any

import numpy as np
from bokeh.events import SelectionGeometry
from bokeh.models.widgets.buttons import Button
from bokeh.models.widgets.inputs import Select, Spinner
from bokeh.models.widgets.markups import Div

from reports.limits import Limit
from reports.words import explore as words

from ..worker import line_of
from . import figures as draw
from . import markup
from .state import NightState

#: Shortest and longest pause between two answers to a line that moves [ms].
_PAUSE_MS = (10, 80)


class LimitsPanel:
    """Choice of the quantity, figure, fields of both ends, and the way back to the limits of the run."""

    def __init__(self, state: NightState) -> None:
        self.state = state
        night = state.night
        names = quantities(state)
        options = [(name, words.quantity_words(name)) for name in names]
        wide: dict[str, Any] = {"sizing_mode": "stretch_width"}
        self.quantity = Select(title="Quantity", options=options, value=names[0] if names else "", **wide)
        self.low, self.high = (Spinner(title=title, mode="float", **wide) for title in ("min", "max"))
        self.reading = Div(text="", visible=False, **wide)
        self.reset = Button(label="Limits of the run", align="end", **wide)
        self.distribution = draw.distribution()
        self.window = draw.window_of("", np.full(len(night.devices), np.nan), None)
        self._waiting, self._next = False, -math.inf
        self.quantity.on_change("value", state.then(self.choose))
        for span, spinner in ((self.distribution.low, self.low), (self.distribution.high, self.high)):
            span.on_change("location", state.then(self._moves))
            spinner.on_change("value", state.then(self.typed))
        self.reset.on_click(self._restore)
        self.distribution.figure.on_event(SelectionGeometry, self._range)
        state.follow("verdicts", self.bars)
        state.follow("judged", self.scale)
        state.follow("wafer", self.scale)
        state.follow("selection", self.outline)
        if night.known:
            self.choose()

    def limit(self) -> Limit:
        """The limit of the shown quantity; infinite ends where there is none."""
        name = self.quantity.value
        known = (one for one in self.state.limits.limits if one.quantity == name)
        return next(known, Limit(name, -math.inf, math.inf))

    def choose(self) -> None:
        """Show another quantity."""
        name, limit = self.quantity.value, self.limit()
        finite = math.isfinite(limit.low) or math.isfinite(limit.high)
        self.window = draw.window_of(name, self.state.night.value(name), limit if finite else None)
        drawn = self.distribution.figure
        drawn.x_range.start = drawn.x_range.reset_start = self.window.low
        drawn.x_range.end = drawn.x_range.reset_end = self.window.high
        draw.axis_words(drawn, name)
        self.state.quietly(self._place)
        self.scale()
        self.outline()
        self._read(name)

    def _read(self, name: str) -> None:
        """Read the draws of a quantity where they are not there, which takes seconds in a large run; its fields wait."""
        night, state = self.state.night, self.state
        if night.holds(name):
            self._wait("")
            return
        self._wait(words.READING_DRAWS)

        def there(found: Any) -> None:
            if self.quantity.value == name:
                self._wait(line_of(found) if isinstance(found, Exception) else "")

        state.work(lambda: night.draws(name), there)

    def _wait(self, why: str) -> None:
        """Let the fields wait, and say why; "" lets them be used."""
        self.low.disabled = self.high.disabled = bool(why)
        self.reading.update(text=markup.note_html(why), visible=bool(why))

    def _ends(self) -> tuple[tuple[Any, Any, float], ...]:
        """Line, field and value of both ends."""
        limit = self.limit()
        return (self.distribution.low, self.low, limit.low), (self.distribution.high, self.high, limit.high)

    def _place(self) -> None:
        """Lines and fields at the limit."""
        for span, spinner, end in self._ends():
            spinner.step = 10.0 * self.window.step
            spinner.value = span.location = end if math.isfinite(end) else None
            span.visible = math.isfinite(end)

    def _fields(self) -> None:
        """Fields at the limit; the lines are in the user's hand."""
        for _, spinner, end in self._ends():
            spinner.value = end if math.isfinite(end) else None

    def _moves(self) -> None:
        # The first movement is answered at once.  After that every position of the mouse is an event; those that came while a
        # preview was computed are read in the pause, and one further preview answers them all.  Without the pause each would be
        # answered, later and later.
        pause_s = self._next - perf_counter()
        if self._waiting:
            return
        if pause_s <= 0.0:
            self.dragged()
            return
        self._waiting = True
        self.state.document.add_timeout_callback(self.dragged, math.ceil(1e3 * pause_s))

    def dragged(self) -> None:
        """Take the limit over from the lines."""
        self._waiting, start = False, perf_counter()
        self._follow_lines()
        end = perf_counter()
        self._next = end + 1e-3 * float(np.clip(1e3 * (end - start), *_PAUSE_MS))

    def _follow_lines(self) -> None:
        wanted = []
        for span, _, before in self._ends():
            if not span.visible or span.location is None:
                wanted.append(before)
                continue
            value = self.window.rounded(float(span.location))
            # The line that did not move keeps its limit to the last digit.
            wanted.append(before if abs(value - before) <= 0.5 * self.window.step else value)
        self.state.take(self.quantity.value, *wanted)
        self.state.quietly(self._fields)

    def typed(self) -> None:
        """Take the limit over from the fields."""
        low = -math.inf if self.low.value is None else float(self.low.value)
        high = math.inf if self.high.value is None else float(self.high.value)
        self.state.take(self.quantity.value, low, high)
        # What was refused stays in the fields, where it can be mended: an arc needs its other end.
        if not self.state.message:
            self.state.quietly(self._place)

    def _restore(self) -> None:
        self.state.restore()
        self.choose()

    def bars(self) -> None:
        """The shown devices by verdict."""
        rows = np.flatnonzero(self.state.night.on(self.state.wafer))
        counts = self.window.counts(self.state.judged.codes, rows)
        self.distribution.bars.data = draw.stacked(self.window.edges, counts)

    def scale(self) -> None:
        """The same, with the axis to its height."""
        self.bars()
        drawn = self.distribution.figure
        drawn.y_range.start = drawn.y_range.reset_start = 0
        most = max(1.0, float(np.max(self.distribution.bars.data["fail"], initial=0.0)))
        drawn.y_range.end = drawn.y_range.reset_end = 1.08 * most

    def outline(self) -> None:
        """The selected devices."""
        chosen = self.state.selected
        counts = self.window.counts(self.state.judged.codes, chosen).sum(axis=0)
        known = chosen.size > 0
        heights = [*counts.tolist(), 0] if known else []
        self.distribution.selected.data = {"x": self.window.edges if known else [], "y": heights}

    def _range(self, event: Any) -> None:
        """A range of the distribution was selected."""
        if not event.final or event.geometry.get("type") != "rect":
            return
        low, high = sorted((event.geometry["x0"], event.geometry["x1"]))
        value = self.window.shown
        self.state.selected = np.flatnonzero((value >= low) & (value <= high) & self.state.night.on(self.state.wafer))
        self.state.tell("selection")


def quantities(state: NightState) -> list[str]:
    """The quantities of which the run knows something, limited ones first."""
    known = state.night.known
    limited = [name for name in state.night.limits.quantities if name in known]
    return list(dict.fromkeys((*limited, *known)))
