"""The residual of one record by frequency, by time and by level, with the given model and with the chosen one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import zip_longest
from typing import Any

import numpy as np
from bokeh.models import ColumnDataSource, Range1d
from bokeh.models.annotations.geometry import Span
from bokeh.models.widgets.inputs import Select
from bokeh.plotting import figure

from reports.learning.decay_view import DecayView
from reports.learning.tone_view import ToneView
from reports.words.explore_loop import NO_RECORDS, NO_SPECTRUM
from reports.words.quantities import error_words

from ..look import AFTER, BEFORE, DRAWN, Panel, plot
from ..parts import controls, legend_above, offer, on, paragraphs, plain_ticks, show_range, stacked, text
from .curves import (
    Curve,
    View,
    bands,
    by_drive,
    by_frequency,
    by_response,
    by_time,
    decay,
    error_of,
    largest_drive,
    name_of,
    worst,
)

Views = Sequence[View]


class ResidualPanels:
    """Controls and figures; ``show`` gives the records beside both models."""

    def __init__(self) -> None:
        self._before: Views = ()
        self._after: Views = ()
        self._bands: Mapping[str, tuple[float, float]] = {}
        self._parameters: Mapping[str, float] = {}
        self.record = Select(title="Record", width=260)
        self.channel = Select(title="Sense", width=110)
        self.band = Select(title="Band of the spectrum", width=280)
        self.unit = Select(title="Unit", options=["σ", "V"], value="σ", width=80)
        self.spectrum = _figure("Residual by frequency", "frequency, Hz", x="linear")
        self.measured = ColumnDataSource({"x": [], "measured": [], "model": []})
        _beside(self.spectrum, self.measured)
        self.time = _figure("Residual by time", "time, s", x="linear")
        self.decayed = ColumnDataSource({"x": [], "measured": [], "model": []})
        _beside(self.time, self.decayed)
        self.response = _figure("Residual by level of the response", "response, V rms", x="log")
        self.drive = _figure(
            "Residual by level of the drive, all records", "largest drive of the record, V", x="linear"
        )
        self._figures = (self.spectrum, self.time, self.response, self.drive)
        self._pairs = [_pair(one, one is self.drive) for one in self._figures]
        self._noise = [Span(dimension="width", line_color=DRAWN, line_dash="dashed") for _ in self._pairs]
        for drawn, line in zip(self._figures, self._noise):
            drawn.add_layout(line)
        self.note = text()
        on(self.record, "value", self._recorded)
        for one in (self.channel, self.band):
            on(one, "value", self.draw)
        on(self.unit, "value", self.draw)

    @property
    def panels(self) -> list[Panel]:
        """The panels of the page."""
        chosen = stacked(controls(self.record, self.channel, self.band, self.unit), self.note)
        both = "Orange: given model; blue: with the added effects; dashed: noise."
        return [
            Panel(chosen, "Record", wide=True),
            Panel(self.spectrum, "Residual by frequency", both),
            Panel(self.time, "Residual by time", "rms in blocks of the record."),
            Panel(self.response, "Residual by level of the response", "rms of short pieces by the response in them."),
            Panel(self.drive, "Residual by level of the drive", "Each record is a point."),
        ]

    def show(self, before: Views, after: Views, parameters: Mapping[str, float]) -> None:
        """Show the records beside the given model and beside the chosen one; ``after`` is empty where they are the same."""
        self._before, self._after, self._parameters = before, after, parameters
        if not before:
            self.note.text = paragraphs([NO_RECORDS])
            return
        latest = after or before
        held = {"validate": " (held out)"}
        errors = {name_of(one): f"{held.get(one.role, '')}: {error_words(error_of(one))} σ" for one in latest}
        offer(self.record, {name: f"{name}{words}" for name, words in errors.items()})
        if self.record.value not in {name_of(one) for one in latest}:
            self.record.value = worst(before)
        else:
            self._recorded()

    def _recorded(self) -> None:
        """Another record, or new models: its channels and bands."""
        view = self._named(self._before)
        if view is None:
            return
        senses = [str(k + 1) for k in range(view.residual.shape[1])]
        self._bands = bands(self._parameters, view)
        offer(self.channel, senses)
        offer(self.band, list(self._bands))
        if self.channel.value not in senses:
            self.channel.value = senses[0]
        if self.band.value not in self._bands:
            self.band.value = next(iter(self._bands), "")
        self.band.disabled = not self._bands
        self.draw()

    def _named(self, views: Views) -> View | None:
        return next((one for one in views if name_of(one) == self.record.value), None)

    def draw(self) -> None:
        """Draw what the controls name."""
        first = self._named(self._before)
        if first is None or not self.channel.value:
            return
        channel, white = int(self.channel.value) - 1, self.unit.value == "σ"
        last = self._named(self._after)
        band, unit = self._bands.get(self.band.value, (0.0, 0.0)), self.unit.value
        shown = [by_frequency(view, channel, band, white) for view in (first, last) if view is not None]
        now = shown[-1]
        self.measured.data = {"x": now.frequency_hz, "measured": now.measured, "model": now.model}
        records = [view for view in (first, last) if view is not None]
        drawn = (
            [Curve(one.frequency_hz, one.residual) for one in shown],
            [by_time(one, channel, white) for one in records],
            [by_response(one, channel, white) for one in records],
            [by_drive(every, channel, white) for every in (self._before, self._after) if every],
        )
        sigma_v = float(np.nanmedian(by_time(first, channel, False).y / by_time(first, channel, True).y))
        level = 1.0 if white else sigma_v
        noise = [now.noise, level, level, level]
        self._decay(records[-1], channel, sigma_v if white else 1.0)
        both = (self.measured, self.decayed, None, None)
        for figure_, sources, curves, value, beside in zip(self._figures, self._pairs, drawn, noise, both):
            for source, curve in zip_longest(sources, curves):
                source.data = {"x": [], "y": []} if curve is None else _positive(curve)
            show_range(figure_.x_range, *(one.x for one in curves), log=figure_ is self.response)
            above = [] if beside is None else [beside.data["measured"], beside.data["model"]]
            show_range(figure_.y_range, *(one.y for one in curves), *above, value, log=True)
        for line, value in zip(self._noise, noise):
            line.location = value if np.isfinite(value) and value > 0.0 else None
        self.time.xaxis.axis_label = "row" if isinstance(first, ToneView) else "time, s"
        driven = any(largest_drive(view) for view in self._before)
        self.drive.xaxis.axis_label = f"largest {'drive' if driven else 'response'} of the record, V"
        self.spectrum.visible = not isinstance(first, DecayView)
        self.note.text = "" if self.spectrum.visible else paragraphs([NO_SPECTRUM])
        for one, what in zip(self._figures, ("amplitude", *["rms"] * 3)):
            one.yaxis.axis_label = f"{what}, {unit}"

    def _decay(self, view: View, channel: int, unit_v: float) -> None:
        """Amplitudes of a decay beside its residual, in units of ``unit_v`` [V]; nothing of another record."""
        found: tuple[Any, Any, Any] = ([], [], [])
        if isinstance(view, DecayView):
            time_s, measured, model = decay(view, channel)
            found = time_s, measured / unit_v, model / unit_v
        self.decayed.data = dict(zip(("x", "measured", "model"), found))
        self.time.legend.visible = isinstance(view, DecayView)


def _figure(name: str, x_label: str, x: str) -> figure:
    drawn = plot(
        name, x_label, "", height=260, tools="box_zoom,pan,reset", x_axis_type=x, y_axis_type="log",
        x_range=Range1d(start=0.1, end=1.0), y_range=Range1d(start=0.1, end=10.0),
    )  # fmt: skip
    plain_ticks(drawn)
    return drawn


def _beside(drawn: figure, source: ColumnDataSource) -> None:
    """Measurement and model as two curves of a figure."""
    drawn.line("x", "measured", source=source, color=DRAWN, line_width=4, alpha=0.5, legend_label="measured")
    drawn.line("x", "model", source=source, color=DRAWN, line_width=1.2, legend_label="model")
    legend_above(drawn)


def _pair(drawn: figure, points: bool) -> tuple[ColumnDataSource, ColumnDataSource]:
    """Two empty curves of a figure: with the given model and with the chosen one."""
    sources = ColumnDataSource({"x": [], "y": []}), ColumnDataSource({"x": [], "y": []})
    for source, colour, marker in zip(sources, (BEFORE, AFTER), ("square", "circle")):
        if points:
            drawn.scatter("x", "y", source=source, color=colour, marker=marker, size=8, fill_alpha=0.6)
        else:
            drawn.line("x", "y", source=source, color=colour, line_width=1.6)
    return sources


def _positive(curve: Curve) -> dict[str, Any]:
    """The points that a logarithmic axis can show."""
    own = np.isfinite(curve.y) & (curve.y > 0.0) & np.isfinite(curve.x)
    return {"x": curve.x[own], "y": curve.y[own]}
