"""Residual wafer maps: one wafer or all of them, one quantity, beside the given population and beside the chosen one."""

from __future__ import annotations

from typing import Any

import numpy as np
from bokeh.models import ColumnDataSource, HoverTool, LinearColorMapper
from bokeh.models.annotations.legends import ColorBar
from bokeh.models.glyphs import Rect
from bokeh.models.widgets.inputs import Select
from bokeh.palettes import PuOr11
from bokeh.plotting import figure

from pipeline.arrays import FloatArray
from reports.lot.figures import SCALE, LotMaps, stacked_means
from reports.words.explore_lot import NO_PLACES, STACKED
from reports.words.numbers import number

from ..look import DRAWN, Panel, plot
from ..parts import controls, offer, on, paragraphs, stacked, text

_TITLES = ("Residual map: given population, refitted", "Residual map: with the added irregularities")


class MapPanels:
    """Controls and two maps; ``show`` gives the residuals beside both models.

    Parameters
    ----------
    radius_mm : of the wafer [mm].
    """

    def __init__(self, radius_mm: float) -> None:
        self._radius_mm = radius_mm
        self._maps: tuple[LotMaps | None, LotMaps | None] = (None, None)
        self.quantity = Select(title="Quantity", width=220)
        self.wafer = Select(title="Wafer", width=240)
        self.note = text()
        self.colours = LinearColorMapper(palette=list(reversed(PuOr11)), low=-SCALE, high=SCALE)
        self.sources = tuple(ColumnDataSource({"x": [], "y": [], "z": [], "n": []}) for _ in _TITLES)
        colour: Any = {"field": "z", "transform": self.colours}
        self._dies = tuple(
            Rect(x="x", y="y", width=1.0, height=1.0, fill_color=colour, line_color=DRAWN, line_width=0.4)
            for _ in _TITLES
        )
        self.figures = tuple(map(self._figure, _TITLES, self.sources, self._dies))
        for one in (self.quantity, self.wafer):
            on(one, "value", self.draw)

    @property
    def panels(self) -> list[Panel]:
        """The panels of the page."""
        chosen = stacked(controls(self.quantity, self.wafer), self.note)
        return [
            Panel(chosen, "Residuals on the wafer", "Each device against what all others say of it.", wide=True),
            *(Panel(drawn, title) for drawn, title in zip(self.figures, _TITLES)),
        ]

    def show(self, before: LotMaps, after: LotMaps | None) -> None:
        """Show the residuals beside the given population and, where something was added, beside the chosen one."""
        self._maps = (before, after)
        wafers = sorted(set(before.wafers))
        offer(self.wafer, [STACKED, *wafers])
        if self.wafer.value not in wafers:
            self.wafer.value = STACKED
        if not np.any(_placed(before)):
            self.note.text = paragraphs([NO_PLACES])
        offer(self.quantity, before.quantities)
        if self.quantity.value not in before.quantities:
            self.quantity.value = _worst(before)
        else:
            self.draw()

    def draw(self) -> None:
        """Draw what the controls name."""
        lines = []
        for maps, source, dies, title in zip(self._maps, self.sources, self._dies, _TITLES):
            if maps is None or self.quantity.value not in maps.quantities or not np.any(_placed(maps)):
                source.data = {"x": [], "y": [], "z": [], "n": []}
                continue
            x, y, z, n = values(maps, str(self.quantity.value), str(self.wafer.value))
            source.data = {"x": x, "y": y, "z": z, "n": n}
            dies.update(width=0.92 * pitch(maps.x_mm), height=0.92 * pitch(maps.y_mm))
            what = title.partition(": ")[2]
            lines.append(
                f"{what}: rms {number(float(np.sqrt(np.mean(z**2))), 3)} on {z.size} places (1 is as expected)."
            )
        if lines:
            self.note.text = paragraphs([line[:1].upper() + line[1:] for line in lines])

    def _figure(self, title: str, source: ColumnDataSource, glyph: Rect) -> figure:
        drawn = plot(title, "x, mm", "y, mm", height=380, match_aspect=True)
        drawn.circle([0.0], [0.0], radius=self._radius_mm, fill_alpha=0.0, line_color=DRAWN)
        dies = drawn.add_glyph(source, glyph)
        drawn.add_layout(ColorBar(color_mapper=self.colours, title="sd", width=10), "right")
        drawn.add_tools(
            HoverTool(
                renderers=[dies], tooltips=[("x, y", "@x, @y mm"), ("residual", "@z{0.00} sd"), ("devices", "@n")]
            )
        )
        return drawn


def values(maps: LotMaps, quantity: str, wafer: str) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """x, y [mm], residual and number of devices of each place (K,); of one wafer [sd], or the mean of all [sd of the mean]."""
    column = maps.quantities.index(quantity)
    if wafer == STACKED:
        places, count, mean = stacked_means(maps)
        own = count[:, column] > 0
        return places.real[own], places.imag[own], mean[own, column], count[own, column]
    own = (np.array(maps.wafers) == wafer) & _placed(maps) & np.isfinite(maps.z[:, column])
    return maps.x_mm[own], maps.y_mm[own], maps.z[own, column], np.ones(int(own.sum()))


def pitch(at_mm: FloatArray) -> float:
    """Median step between neighbouring places along one axis [mm]; 1 where there is one place."""
    steps = np.diff(np.unique(np.round(at_mm[np.isfinite(at_mm)], 3)))
    return float(np.median(steps)) if steps.size else 1.0


def _placed(maps: LotMaps) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    return np.asarray(np.isfinite(maps.x_mm) & np.isfinite(maps.y_mm))


def _worst(maps: LotMaps) -> str:
    """The quantity with most structure in the stacked map."""
    if not np.any(_placed(maps)):
        return maps.quantities[0]
    return maps.quantities[int(np.argmax(np.mean(stacked_means(maps)[2] ** 2, axis=0)))]
