"""What the next record would show: its prediction without and with one effect, at a level that the user chooses."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from bokeh.models import ColumnDataSource, Range1d
from bokeh.models.annotations.geometry import Span
from bokeh.models.widgets.inputs import Select
from bokeh.models.widgets.sliders import Slider
from bokeh.plotting import figure

from pipeline.arrays import FloatArray
from pipeline.experiment.envelopes import EnvelopeRecord
from pipeline.learning.joint.next_record import Repeat, RepeatedRecord
from reports.learning.decay_view import DecayView
from reports.learning.record_view import RecordView
from reports.learning.tone_view import ToneView
from reports.words.campaign import effect_words
from reports.words.explore_loop import NO_DRIVE, next_record_sentences

from ..look import DRAWN, FEW, Panel, plot
from ..parts import controls, legend_above, offer, on, paragraphs, plain_ticks, show_range, stacked, text
from .bench import Next, Told
from .curves import View, bands, by_frequency, by_time

#: Heading of the panel.
NEXT = "What would the next record show"
#: Range of the drive scale; 1 is the highest level of the records so far.
SCALES = (0.1, 2.0)
_SENSES = 2
#: Least difference that is drawn [sigma]; it is nothing beside the noise.
_LEAST = 1e-2


class NextPanel:
    """Controls, sentences and figures.

    Parameters
    ----------
    ask : called with an effect and an experiment that the user wants to see.
    listed : called with an effect whose experiments the user wants to see.
    """

    def __init__(self, ask: Callable[[str, Next], None], listed: Callable[[str], None]) -> None:
        self._ask, self._listed = ask, listed
        self._experiments: dict[str, Next] = {}
        self.effect = Select(title="Without and with", width=240)
        self.shape = Select(title="Excitation of the next record", width=380)
        self.scale = Slider(
            title="Level scale (1: as measured so far)",
            start=SCALES[0],
            end=SCALES[1],
            step=0.05,
            value=1.0,
            width=260,
        )
        self.words = text(live=True)
        self.frequency = _figure("Difference of the predictions by frequency", "frequency, Hz", "amplitude / noise")
        self.time = _figure("Difference of the predictions by time", "time, s", "rms, σ")
        self._sources = {
            drawn: [ColumnDataSource({"x": [], "y": []}) for _ in range(_SENSES)]
            for drawn in (self.frequency, self.time)
        }
        for drawn, sources in self._sources.items():
            for k, (source, dash) in enumerate(zip(sources, ("solid", "dashed"))):
                drawn.line(
                    "x", "y", source=source, color=FEW[k], line_dash=dash, line_width=1.6, legend_label=f"sense {k + 1}"
                )
            legend_above(drawn)
            drawn.add_layout(Span(location=1.0, dimension="width", line_color=DRAWN, line_dash="dotted"))
        on(self.effect, "value", self._effect)
        on(self.shape, "value", self.request)
        on(self.scale, "value_throttled", self.request)

    @property
    def panels(self) -> list[Panel]:
        """The panels of the page."""
        note = "Both predictions come from fits to the records so far. Dotted: noise."
        return [
            Panel(
                stacked(controls(self.effect, self.shape, self.scale), self.words),
                NEXT,
                wide=True,
            ),
            Panel(self.frequency, "Next record: difference by frequency", note),
            Panel(self.time, "Next record: difference by time"),
        ]

    def offer(self, effects: Sequence[str]) -> None:
        """The effects that may be chosen, the most interesting first."""
        offer(self.effect, {name: effect_words(name) for name in effects})
        if self.effect.value not in effects:
            self.effect.value = effects[0] if effects else ""
        else:
            self._effect()

    def excite(self, found: Sequence[Next]) -> None:
        """The experiments that may be chosen."""
        self._experiments = {_words(one): one for one in found}
        offer(self.shape, list(self._experiments))
        if not found:
            self.words.text = paragraphs([NO_DRIVE])
        if self.shape.value not in self._experiments:
            self.shape.value = next(iter(self._experiments), "")
        else:
            self.request()

    def request(self) -> None:
        """Ask for the record that the controls name."""
        experiment = self._experiments.get(str(self.shape.value))
        if self.effect.value and experiment is not None:
            self._ask(str(self.effect.value), experiment.scaled(float(self.scale.value)))

    def show(self, found: Told, asked: Next) -> None:
        """Show a prediction of the record that was asked for."""
        self.words.text = paragraphs(next_record_sentences(found, asked.level_v))
        view = difference(found)
        band = next(iter(bands({}, view).values()), (0.0, 0.0))
        for k in range(_SENSES):
            by_f, by_t = self._sources[self.frequency][k], self._sources[self.time][k]
            if k >= view.residual.shape[1]:
                by_f.data = by_t.data = {"x": [], "y": []}
                continue
            spectrum, time = by_frequency(view, k, band, True), by_time(view, k, True)
            by_f.data = _positive(*_at_each(spectrum.frequency_hz, spectrum.residual))
            by_t.data = _positive(time.x, time.y)
        for drawn, sources in self._sources.items():
            show_range(drawn.x_range, *(one.data["x"] for one in sources), log=False)
            show_range(drawn.y_range, *(one.data["y"] for one in sources), 1.0, log=True)
        self.time.xaxis.axis_label = "row" if isinstance(view, ToneView) else "time, s"
        self.frequency.visible = not isinstance(view, DecayView)
        for drawn in self._sources:
            drawn.legend.visible = view.residual.shape[1] > 1

    def _effect(self) -> None:
        if self.effect.value:
            self._listed(str(self.effect.value))


def difference(found: Told) -> View:
    """The next record as a record: measured with the effect, modelled without it, the residual in sigmas."""
    if isinstance(found, RepeatedRecord):
        told, name = found.told, found.experiment.words
        if isinstance(told, EnvelopeRecord):
            without_v = np.abs(found.without_v)
            return DecayView(name, "fit", told.time_s, told.amplitude_v, without_v, found.residual)
        y = np.asarray(found.without_v, dtype=np.complex128)
        return ToneView(name, "", "fit", told.frequency_hz, told.level_v, told.sense_v, y, found.residual)
    residual = (found.with_v - found.without_v) / found.sigma_v
    return RecordView(
        name=found.experiment.words,
        role="fit",
        sample_rate_hz=found.sample_rate_hz,
        drive_v=found.drive_v,
        measured_v=found.with_v,
        model_v=found.without_v,
        residual=residual,
        error=float(np.sqrt(np.mean(residual**2))),
    )


def _words(one: Next) -> str:
    if isinstance(one, Repeat):
        return one.shape
    parts = [one.shape, f"{one.excitation.duration_s:g} s"]
    parts += [] if one.bias_v is None else [f"bias {one.bias_v:.3g} V"]
    parts += [] if one.rate_dps is None else [f"rate {one.rate_dps:g} deg/s"]
    return ", ".join(parts)


def _figure(name: str, x: str, y: str) -> figure:
    drawn = plot(
        name, x, y, height=240, tools="box_zoom,pan,reset", y_axis_type="log",
        x_range=Range1d(start=0.1, end=1.0), y_range=Range1d(start=0.1, end=10.0),
    )  # fmt: skip
    plain_ticks(drawn)
    return drawn


def _at_each(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Each different ``x`` (N,), and the rms of ``y`` there: a sweep has several passes over the same frequencies."""
    every, place, count = np.unique(x, return_inverse=True, return_counts=True)
    return every, np.sqrt(np.bincount(place, weights=y**2) / count)


def _positive(x: object, y: object) -> dict[str, Any]:
    values, at = np.asarray(y, dtype=np.float64), np.asarray(x, dtype=np.float64)
    own = np.isfinite(values) & (values > _LEAST)
    return {"x": at[own], "y": values[own]}
