"""One device: verdict, reasons and estimates at once, records and residual as soon as they are there."""

from __future__ import annotations

from typing import Any

import numpy as np
from bokeh.models.widgets.inputs import Select, TextInput
from bokeh.models.widgets.markups import Div

from reports.words import explore as words

from ..parts import text
from ..worker import line_of
from . import figures as draw
from . import markup
from .device import DeviceView, device_view
from .state import NightState


class DevicePanel:
    """Name of the device, texts, spectrum and residual."""

    def __init__(self, state: NightState) -> None:
        self.state = state
        wide: dict[str, Any] = {"sizing_mode": "stretch_width"}
        self.name = TextInput(title="Device", placeholder=state.night.device_ids[0], **wide)
        self.channel = Select(title="Sense channel", options=[("0", "1"), ("1", "2")], value="0", **wide)
        self.details = text(markup.note_html(words.NO_DEVICE))
        self.left = Div(text="", **wide)
        self.curves = draw.device_figures()
        self.looked: DeviceView | None = None
        self.name.on_change("value", state.then(self._named))
        self.channel.on_change("value", state.then(self.draw))
        state.follow("device", self.look)
        state.follow("judged", self.show)

    def _named(self) -> None:
        """A device was named."""
        name = self.name.value.strip()
        row = self.state.night.number(name)
        if row is None:
            self.details.text = markup.note_html(words.unknown_device(name) if name else words.NO_DEVICE)
            return
        self.state.device, self.state.selected = row, np.array([row], dtype=np.int64)
        self.state.tell("device", "selection")

    def look(self) -> None:
        """Show the device; its records follow."""
        row = self.state.device
        if row is None:
            return
        self.looked = None
        self.state.quietly(lambda: setattr(self.name, "value", self.state.night.device_ids[row]))
        self.show()
        self.left.text = markup.note_html(words.SIMULATING)
        self.draw()
        self.state.work(lambda: device_view(self.state.night, row), lambda found: self._found(row, found))

    def _found(self, row: int, found: Any) -> None:
        if row != self.state.device:
            return
        if isinstance(found, Exception):
            self.left.text = markup.note_html(line_of(found))
            return
        self.looked = found
        virtual = self.state.night.config.source.kind == "population"
        self.left.text = markup.note_html(words.residual_sentence(found.record, found.error, virtual), "residual")
        self.draw()

    def show(self) -> None:
        """Verdict and estimates."""
        if self.state.device is not None:
            self.details.text = markup.device_html(self.state.night, self.state.judged, self.state.device)

    def draw(self) -> None:
        """Spectrum and residual in the chosen channel."""
        found, channel = self.looked, int(self.channel.value)
        if found is None or channel >= found.low.shape[1]:
            self.curves.spectrum.visible = self.curves.residual.visible = False
            return
        shown = found.spectra
        curves = {name: getattr(shown, name)[:, channel] for name in ("measured", "model", "residual")}
        floor = np.full(shown.frequency_hz.size, shown.floor[channel])
        low, high = found.low[:, channel], found.high[:, channel]
        self.curves.lines.data = {"f": shown.frequency_hz, **curves, "floor": floor}
        self.curves.band.data = {"t": found.time_s, "low": low, "high": high}
        draw.fit_ranges(self.curves.spectrum, shown.frequency_hz, *curves.values(), log=True)
        draw.fit_ranges(self.curves.residual, found.time_s, low, high)
        self.curves.spectrum.visible = self.curves.residual.visible = True
