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

from pipeline.learning.next_experiment.experiments import Experiment
from pipeline.learning.next_experiment.predicted import NextRecord
from reports.learning.record_view import RecordView, drive_band
from reports.words.campaign import effect_words
from reports.words.explore_loop import next_record_sentences

from ..look import DRAWN, FEW, Panel, plot
from ..parts import controls, legend_above, offer, on, paragraphs, plain_ticks, show_range, stacked, text
from .curves import by_frequency, by_time

#: Heading of the panel.
NEXT = "What would the next record show"
#: Range of the drive scale; 1 is the highest level of the records so far.
SCALES = (0.1, 2.0)
_SENSES = 2


class NextPanel:
    """Controls, sentences and figures.

    Parameters
    ----------
    ask : called with an effect and an experiment that the user wants to see.
    listed : called with an effect whose experiments the user wants to see.
    """

    def __init__(self, ask: Callable[[str, Experiment], None], listed: Callable[[str], None]) -> None:
        self._ask, self._listed = ask, listed
        self._experiments: dict[str, Experiment] = {}
        self.effect = Select(title="Without and with", width=240)
        self.shape = Select(title="Excitation of the next record", width=380)
        self.scale = Slider(
            title="Drive scale (1: highest level so far)",
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

    def excite(self, found: Sequence[Experiment]) -> None:
        """The experiments that may be chosen."""
        self._experiments = {_words(one): one for one in found}
        offer(self.shape, list(self._experiments))
        if self.shape.value not in self._experiments:
            self.shape.value = next(iter(self._experiments), "")
        else:
            self.request()

    def request(self) -> None:
        """Ask for the record that the controls name."""
        experiment = self._experiments.get(str(self.shape.value))
        if self.effect.value and experiment is not None:
            self._ask(str(self.effect.value), experiment.scaled(float(self.scale.value)))

    def show(self, found: NextRecord, asked: Experiment) -> None:
        """Show a prediction of the record that was asked for."""
        self.words.text = paragraphs(next_record_sentences(found, asked.level_v))
        view = difference(found)
        for k in range(_SENSES):
            by_f, by_t = self._sources[self.frequency][k], self._sources[self.time][k]
            if k >= view.senses:
                by_f.data = by_t.data = {"x": [], "y": []}
                continue
            low, high = drive_band(view)
            room = max(0.2 * (high - low), view.resolution_hz)
            spectrum = by_frequency(view, k, (max(low - room, 0.0), min(high + room, 0.5 * view.sample_rate_hz)), True)
            time = by_time(view, k, True)
            by_f.data = _positive(spectrum.frequency_hz, spectrum.residual)
            by_t.data = _positive(time.x, time.y)
        for drawn, sources in self._sources.items():
            show_range(drawn.x_range, *(one.data["x"] for one in sources), log=False)
            show_range(drawn.y_range, *(one.data["y"] for one in sources), 1.0, log=True)

    def _effect(self) -> None:
        if self.effect.value:
            self._listed(str(self.effect.value))


def difference(found: NextRecord) -> RecordView:
    """The next record as a record: measured with the effect, modelled without it, the residual in sigmas."""
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


def _words(one: Experiment) -> str:
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


def _positive(x: object, y: object) -> dict[str, Any]:
    values, at = np.asarray(y, dtype=np.float64), np.asarray(x, dtype=np.float64)
    own = np.isfinite(values) & (values > 1e-6)
    return {"x": at[own], "y": values[own]}
