"""One session of the page of a night: its widgets, and what happens when they are used.

A limit that moves is judged by the preview within the frame; when it has rested for ``_REST_MS`` the judgement itself starts in a
thread, and replaces the preview if the limits are still the same.  Events that arrive while a preview is computed are answered by
one further preview of the last position.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import Executor
from typing import Any

import numpy as np
from bokeh.document import Document
from bokeh.events import SelectionGeometry
from bokeh.models.sources import ColumnDataSource
from bokeh.models.widgets.buttons import Button
from bokeh.models.widgets.inputs import Select, Spinner, TextInput
from bokeh.models.widgets.markups import Div, PreText

from pipeline.arrays import IntArray
from pipeline.errors import GyroscreenError
from reports.limits import Limit, Limits
from reports.words import explore as words

from . import figures as draw
from . import markup
from .device import DeviceView, device_view
from .file import moved, toml_of
from .judged import Judged, again, as_stored, preview
from .preview import VERDICTS, Kept
from .stored import StoredNight

_REST_MS = 250


class Session:
    """The state of one page.  Everything of the run itself is shared by all sessions and stays as it is."""

    def __init__(self, night: StoredNight, document: Document, worker: Executor) -> None:
        self.night, self.document, self.worker = night, document, worker
        self.judged = as_stored(night)
        self.limits: Limits = night.limits
        self.kept: Kept | None = None
        self.message = ""
        self.rows: IntArray = np.zeros(0, dtype=np.int64)
        self.device: int | None = None
        self._timer: Any = None
        self._waiting = self._quiet = False
        self._widgets()
        self._figures()
        self._connect()
        self.choose_quantity()
        self.choose_wafer()
        self.show()

    # -- parts of the page ------------------------------------------------------------------------------------------------

    def _widgets(self) -> None:
        night = self.night
        limited = [name for name in night.limits.quantities if name in night.known]
        names = list(dict.fromkeys((*limited, *night.known)))
        options = [(name, words.quantity_words(name)) for name in names]
        first = limited[0] if limited else names[0] if names else ""
        wide: dict[str, Any] = {"sizing_mode": "stretch_width"}
        self.total, self.remark, self.drawn = (Div(text="", **wide) for _ in range(3))
        self.quantity = Select(title="Quantity", options=options, value=first, **wide)
        self.low, self.high = (Spinner(title=title, mode="float", **wide) for title in ("min", "max"))
        self.reset = Button(label="Limits of the run", **wide)
        lots = sorted({name for name in night.devices.text("lot").counts() if name})
        groups = [("", words.ALL_WAFERS), *[(name, name) for name in (*lots, *night.wafer_names)]]
        self.wafer = Select(title="Wafer or lot", options=list(dict.fromkeys(groups)), value="", **wide)
        colours = [("verdict", words.VERDICT), ("p_pass", words.P_CONFORM), *options]
        self.colour = Select(title="Colour", options=colours, value="verdict", **wide)
        pair = (*(name for name in ("theta_deg", "split_hz") if name in names), *names, first, first)
        self.x, self.y = (Select(title=t, options=options, value=v, **wide) for t, v in zip("xy", pair, strict=False))
        self.name = TextInput(title="Device", placeholder=night.device_ids[0], **wide)
        self.channel = Select(title="Sense channel", options=[("0", "1"), ("1", "2")], value="0", **wide)
        self.details = Div(text=markup.note_html(words.NO_DEVICE), **wide)
        self.left = Div(text="", **wide)
        self.file = PreText(text="", **wide)

    def _figures(self) -> None:
        self.points = ColumnDataSource({name: [] for name in ("id", "mx", "my", "x", "y", "c", "verdict")})
        self.distribution = draw.distribution()
        self.map = draw.wafer_map(self.points)
        self.pair = draw.scatter(self.points)
        self.window = draw.window_of("", np.zeros(0), None)
        self.looked: DeviceView | None = None
        self.curves = draw.device_figures()

    def _connect(self) -> None:
        self.quantity.on_change("value", self._then(self.choose_quantity))
        for span, spinner in ((self.distribution.low, self.low), (self.distribution.high, self.high)):
            span.on_change("location", self._then(self.drag))
            spinner.on_change("value", self._then(self.type_limits))
        self.reset.on_click(self.restore)
        self.wafer.on_change("value", self._then(self.choose_wafer))
        self.colour.on_change("value", self._then(self.draw_points))
        for select in (self.x, self.y):
            select.on_change("value", self._then(self.draw_points))
        self.points.selected.on_change("indices", self._then(self.select))
        self.distribution.figure.on_event(SelectionGeometry, self.select_range)
        self.name.on_change("value", self._then(self.find_device))
        self.channel.on_change("value", self._then(self.draw_device))

    def _then(self, action: Callable[[], None]) -> Callable[[str, Any, Any], None]:
        """``action`` as an answer to a change that the user made; what the session itself sets is no event."""

        def changed(attribute: str, old: Any, new: Any) -> None:
            if not self._quiet:
                action()

        return changed

    def _set(self, action: Callable[[], None]) -> None:
        """Run ``action``, whose changes are no events."""
        before, self._quiet = self._quiet, True
        try:
            action()
        finally:
            self._quiet = before

    # -- limits -----------------------------------------------------------------------------------------------------------

    def limit(self) -> Limit:
        """The limit of the quantity that is shown; infinite ends where there is none."""
        name = self.quantity.value
        known = (one for one in self.limits.limits if one.quantity == name)
        return next(known, Limit(name, -math.inf, math.inf))

    def choose_quantity(self) -> None:
        """Show another quantity."""
        name, limit = self.quantity.value, self.limit()
        finite = math.isfinite(limit.low) or math.isfinite(limit.high)
        self.window = draw.window_of(name, self.night.value(name), limit if finite else None)
        drawn = self.distribution.figure
        drawn.x_range.start, drawn.x_range.end = self.window.low, self.window.high
        drawn.x_range.reset_start, drawn.x_range.reset_end = self.window.low, self.window.high
        draw.axis_words(drawn, name)
        self.kept = None
        self._set(self._place_limit)
        self.draw_bars(rescale=True)

    def _place_limit(self) -> None:
        """Lines and fields at the limit."""
        limit = self.limit()
        ends = ((self.distribution.low, self.low, limit.low), (self.distribution.high, self.high, limit.high))
        for span, spinner, end in ends:
            spinner.step = 10.0 * self.window.step
            spinner.value = end if math.isfinite(end) else None
            span.location = end if math.isfinite(end) else None
            span.visible = math.isfinite(end)

    def drag(self) -> None:
        """A line was moved; the last position counts."""
        if not self._waiting:
            self._waiting = True
            self.document.add_next_tick_callback(self.dragged)

    def dragged(self) -> None:
        """Take the limits over from the lines."""
        self._waiting = False
        low, high = (
            self.window.rounded(float(span.location)) if span.visible and span.location is not None else infinite
            for span, infinite in ((self.distribution.low, -math.inf), (self.distribution.high, math.inf))
        )
        before = self.limit()
        # The line that did not move keeps its limit to the last digit.
        same = 0.5 * self.window.step
        low = before.low if abs(low - before.low) <= same else low
        high = before.high if abs(high - before.high) <= same else high
        self.take(low, high)

        def fields() -> None:
            now = self.limit()
            for spinner, end in ((self.low, now.low), (self.high, now.high)):
                spinner.value = end if math.isfinite(end) else None

        self._set(fields)

    def type_limits(self) -> None:
        """Take the limits over from the fields."""
        low = -math.inf if self.low.value is None else float(self.low.value)
        high = math.inf if self.high.value is None else float(self.high.value)
        self.take(low, high)
        self._set(self._place_limit)

    def restore(self) -> None:
        """Back to the limits of the run."""
        self.limits, self.kept, self.message = self.night.limits, None, ""
        self.judged = as_stored(self.night)
        self.choose_quantity()
        self.show()

    def take(self, low: float, high: float) -> None:
        """Judge by the limits with that of the shown quantity at ``low`` and ``high``."""
        name = self.quantity.value
        try:
            limits = moved(self.limits, name, low, high)
        except GyroscreenError as error:
            self.message = str(error)
            self.show_total()
            return
        self.message = ""
        if limits == self.limits:
            return
        self.limits = limits
        self.judged, self.kept = preview(self.night, limits, name, self.kept)
        self.show_total()
        self.draw_bars()
        self._rest()

    def _rest(self) -> None:
        """Judge when the limits have not moved for a while."""
        if self._timer is not None:
            self.document.remove_timeout_callback(self._timer)
        self._timer = self.document.add_timeout_callback(self._rested, _REST_MS)

    def _rested(self) -> None:
        self._timer = None
        limits = self.limits
        self._work(lambda: again(self.night, limits), lambda found: self._replace(limits, found))

    def _replace(self, limits: Limits, found: Judged | GyroscreenError) -> None:
        if limits != self.limits:
            return
        if isinstance(found, GyroscreenError):
            self.message = str(found)
            self.show_total()
            return
        self.judged = found
        self.show()

    def _work(self, task: Callable[[], Any], done: Callable[[Any], None]) -> None:
        """Run ``task`` in the thread of the server's work, then ``done`` with its result or typed error."""

        def run() -> None:
            found: Any
            try:
                found = task()
            except GyroscreenError as error:
                found = error
            self.document.add_next_tick_callback(lambda: done(found))

        self.worker.submit(run)

    # -- what is shown ----------------------------------------------------------------------------------------------------

    def show(self) -> None:
        """All that depends on the verdicts."""
        self.show_total()
        self.draw_bars(rescale=True)
        self.points.data = {**self.points.data, "verdict": self._verdicts()}
        if self.colour.value == "p_pass":
            self.draw_points()
        self.file.text = toml_of(self.limits)
        self.show_device()
        self.show_selected()

    def show_total(self) -> None:
        """The yield."""
        self.total.text = markup.yield_html(self.judged, self.message)

    def draw_bars(self, rescale: bool = False) -> None:
        """The distribution of the devices on the chosen wafer, by verdict."""
        rows = np.flatnonzero(self.night.on(self.wafer.value))
        counts = self.window.counts(self.judged.codes, rows)
        self.distribution.bars.data = draw.stacked(self.window.edges, counts)
        if rescale:
            self.distribution.figure.y_range.start = 0
            self.distribution.figure.y_range.end = 1.08 * max(1, int(counts.sum(axis=0).max()))

    def choose_wafer(self) -> None:
        """Show another wafer or lot."""
        night = self.night
        rows = np.flatnonzero(night.on(self.wafer.value))
        step = max(1, -(-rows.size // draw.POINTS))
        self.rows = rows[::step]
        found = draw.places(night, self.wafer.value)
        self.map.outlines.data = draw.outlines_of(found)
        known = np.isfinite(found.x[rows]).any()
        self.drawn.text = markup.note_html(
            words.shown_sentence(self.rows.size, rows.size) if known else words.NO_DIES
        )
        place = {"mx": found.x[self.rows], "my": found.y[self.rows]}
        names = [night.device_ids[row] for row in self.rows]
        empty = np.zeros(self.rows.size)
        self._set(lambda: setattr(self.points.selected, "indices", []))
        self.points.data = {"id": names, **place, "x": empty, "y": empty, "c": empty, "verdict": self._verdicts()}
        self.draw_points()
        self.draw_bars(rescale=True)
        self.show_selected()

    def _verdicts(self) -> list[str]:
        return [VERDICTS[code] for code in self.judged.codes[self.rows].tolist()]

    def draw_points(self) -> None:
        """Positions in the scatter plot and colours of the map."""
        night, rows, by = self.night, self.rows, self.colour.value
        x, y = (night.value(name.value)[rows] for name in (self.x, self.y))
        colour = np.zeros(rows.size)
        if by != "verdict":
            colour = (self.judged.p_pass if by == "p_pass" else night.value(by))[rows]
            ends = (0.0, 1.0) if by == "p_pass" else _central(colour)
            self.map.scale.low, self.map.scale.high = ends
            self.map.bar.title = words.P_CONFORM if by == "p_pass" else words.quantity_words(by)
        self.map.verdicts.visible = by == "verdict"
        self.map.numbers.visible = self.map.bar.visible = by != "verdict"
        draw.axis_words(self.pair, self.x.value, self.y.value)
        self.points.data = {**self.points.data, "x": x, "y": y, "c": colour}

    # -- selection and one device -----------------------------------------------------------------------------------------

    def select(self) -> None:
        """Devices were selected in a figure."""
        chosen = self.points.selected.indices
        if len(chosen) == 1:
            self.look(int(self.rows[chosen[0]]))
        self.show_selected()

    def select_range(self, event: Any) -> None:
        """A range of the distribution was selected."""
        if not event.final or event.geometry.get("type") != "rect":
            return
        low, high = sorted((event.geometry["x0"], event.geometry["x1"]))
        value = self.window.shown[self.rows]
        found = np.flatnonzero((value >= low) & (value <= high)).tolist()
        self._set(lambda: setattr(self.points.selected, "indices", found))
        self.show_selected()

    def show_selected(self) -> None:
        """How many devices are selected, and their outline in the distribution."""
        chosen = self.rows[np.asarray(self.points.selected.indices, dtype=np.int64)]
        passed = int(np.sum(self.judged.codes[chosen] == VERDICTS.index("pass")))
        self.remark.text = markup.note_html(words.selected_sentence(chosen.size, passed))
        counts = self.window.counts(self.judged.codes, chosen).sum(axis=0)
        heights = [*counts.tolist(), 0] if chosen.size else []
        self.distribution.selected.data = {"x": self.window.edges if chosen.size else [], "y": heights}

    def find_device(self) -> None:
        """A device was named."""
        name = self.name.value.strip()
        row = self.night.number(name)
        if row is None:
            self.details.text = markup.note_html(words.unknown_device(name)) if name else ""
            return
        place = np.flatnonzero(self.rows == row).tolist()
        self._set(lambda: setattr(self.points.selected, "indices", place))
        self.show_selected()
        self.look(row)

    def look(self, row: int) -> None:
        """Show a device; its records follow."""
        self.device, self.looked = row, None
        self._set(lambda: setattr(self.name, "value", self.night.device_ids[row]))
        self.show_device()
        self.left.text = markup.note_html(words.SIMULATING)
        self.draw_device()
        self._work(lambda: device_view(self.night, row), lambda found: self._looked(row, found))

    def _looked(self, row: int, found: DeviceView | GyroscreenError) -> None:
        if row != self.device:
            return
        if isinstance(found, GyroscreenError):
            self.left.text = markup.note_html(str(found))
            return
        self.looked = found
        virtual = self.night.config.source.kind == "population"
        self.left.text = markup.note_html(words.residual_sentence(found.record, found.error, virtual))
        self.draw_device()

    def show_device(self) -> None:
        """Verdict and estimates of the device."""
        if self.device is not None:
            self.details.text = markup.device_html(self.night, self.judged, self.device)

    def draw_device(self) -> None:
        """Spectrum and residual of the device in the chosen channel."""
        found, channel = self.looked, int(self.channel.value)
        if found is None or channel >= found.low.shape[1]:
            self.curves.lines.data = {name: [] for name in self.curves.lines.data}
            self.curves.band.data = {name: [] for name in self.curves.band.data}
            return
        shown = found.spectra
        self.curves.lines.data = {
            "f": shown.frequency_hz,
            **{name: getattr(shown, name)[:, channel] for name in ("measured", "model", "residual")},
            "floor": np.full(shown.frequency_hz.size, shown.floor[channel]),
        }
        self.curves.band.data = {"t": found.time_s, "low": found.low[:, channel], "high": found.high[:, channel]}


def _central(values: Any) -> tuple[float, float]:
    """The central 96 % of the known values."""
    known = values[np.isfinite(values)]
    if not known.size:
        return 0.0, 1.0
    low, high = np.quantile(known, [0.02, 0.98])
    return float(low), float(high if high > low else low + 1.0)


