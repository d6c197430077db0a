"""The figures of a night: distribution with limits that move, wafer map, two quantities, spectrum and residual of a device.

Shapes: B devices of the run, n drawn devices, K bins.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from bokeh.models.annotations.geometry import Span
from bokeh.models.annotations.legends import ColorBar
from bokeh.models.mappers import CategoricalColorMapper, CategoricalMarkerMapper, LinearColorMapper
from bokeh.models.renderers.glyph_renderer import GlyphRenderer
from bokeh.models.sources import ColumnDataSource
from bokeh.models.tickers import BasicTicker
from bokeh.models.tools import HoverTool
from bokeh.plotting import figure

from pipeline.arrays import FloatArray, IntArray
from pipeline.axial import difference, mean_axis
from pipeline.quantities import AXES
from reports.limits import Limit
from reports.words.explore import quantity_words
from reports.yields import natural

from ..look import COLOURS, DRAWN, EDGES, HATCHES, MARKERS, plot
from .preview import VERDICTS
from .stored import NightData

#: Most devices that are drawn one by one; most wafers that are drawn side by side.
POINTS, WAFERS = 4000, 60
_BINS = 48
#: Distances of wafers in a row and of rows, in radii; names need room.
_ACROSS, _DOWN = 2.3, 2.7
#: Ranges of a figure without data: Bokeh warns where it has to find them from nothing.
_EMPTY: dict[str, Any] = {"x_range": (0.1, 1.0), "y_range": (0.1, 1.0)}


@dataclass(frozen=True, eq=False)
class Window:
    """What a distribution shows: bins of equal width.

    Parameters
    ----------
    low, high : ends of the axis, in the unit of the quantity.
    place : (B,) number of each device's bin; -1 where the quantity is unknown.
    shown : (B,) the value as it is drawn: an axis is unwrapped into the window.
    step : distance of the positions that a limit can take.
    """

    low: float
    high: float
    place: IntArray
    shown: FloatArray
    step: float

    @property
    def edges(self) -> FloatArray:
        """(K + 1,) edges of the bins."""
        return np.linspace(self.low, self.high, _BINS + 1)

    def counts(self, codes: IntArray, rows: IntArray) -> IntArray:
        """(3, K) devices of ``rows`` by verdict and bin."""
        place = self.place[rows]
        known = place >= 0
        key = codes[rows][known] * _BINS + place[known]
        return np.bincount(key, minlength=len(VERDICTS) * _BINS).reshape(len(VERDICTS), _BINS)

    def rounded(self, value: float) -> float:
        """``value`` on the grid of positions."""
        return round(value / self.step) * self.step if self.step >= 1 else round(value, -round(math.log10(self.step)))


def window_of(quantity: str, values: FloatArray, limit: Limit | None) -> Window:
    """The window of a quantity: the central 98 % of its values and its limits, with room beyond; for an axis 180 deg."""
    finite = values[np.isfinite(values)]
    if quantity in AXES:
        middle = 0.5 * (limit.low + limit.high) if limit is not None else mean_axis(finite)
        middle = 0.0 if math.isnan(middle) else middle
        low, high = middle - 90.0, middle + 90.0
        shown = middle + np.asarray(difference(values, middle))
    else:
        marks = [*np.quantile(finite, [0.01, 0.99])] if finite.size else [0.0, 1.0]
        marks += [end for end in (limit.low, limit.high) if math.isfinite(end)] if limit is not None else []
        room = 0.12 * (max(marks) - min(marks)) or 0.1 * abs(marks[0]) or 1.0
        low, high, shown = float(min(marks) - room), float(max(marks) + room), values
    place = np.floor((shown - low) / (high - low) * _BINS)
    # Values beyond the window count in its last bars, so every device is shown.
    place = np.where(np.isfinite(shown), np.clip(place, 0, _BINS - 1), -1).astype(np.int64)
    return Window(low, high, place, shown, 10.0 ** math.floor(math.log10((high - low) / 500.0)))


@dataclass(frozen=True, eq=False)
class Distribution:
    """The figure of a distribution: bars by verdict, outline of the selected devices, both ends of the limit."""

    figure: figure
    bars: ColumnDataSource
    selected: ColumnDataSource
    low: Span
    high: Span


def distribution() -> Distribution:
    """An empty one; fill its sources and ranges."""
    drawn = plot("Limits and distribution", "", "devices", tools="xbox_select,reset", x_range=(0, 1), y_range=(0, 1))
    bars = ColumnDataSource({name: [] for name in ("left", "right", "zero", *VERDICTS)})
    below = "zero"
    for verdict in ("pass", "undecided", "fail"):
        drawn.quad(
            left="left", right="right", bottom=below, top=verdict, source=bars, fill_color=COLOURS[verdict],
            line_color=None, hatch_pattern=HATCHES[verdict], hatch_color=EDGES[verdict], hatch_alpha=0.7, hatch_scale=7,
            legend_label=verdict, selection_fill_alpha=1.0, nonselection_fill_alpha=1.0,
        )  # fmt: skip
        below = verdict
    selected = ColumnDataSource({"x": [], "y": []})
    drawn.step("x", "y", source=selected, mode="after", line_color=DRAWN, line_width=2)
    ends = [Span(dimension="height", location=None, editable=True, line_width=3, line_dash="dashed") for _ in range(2)]
    for end in ends:
        end.level = "overlay"
        drawn.add_layout(end)
    _legend_above(drawn)
    drawn.xgrid.visible, drawn.yaxis.ticker = False, BasicTicker(min_interval=1)
    return Distribution(drawn, bars, selected, ends[0], ends[1])


def stacked(edges: FloatArray, counts: IntArray) -> dict[str, FloatArray]:
    """Data of the bars of :func:`distribution`: tops of the stacked verdicts."""
    zero = np.zeros(edges.size - 1)
    passed = counts[VERDICTS.index("pass")].astype(np.float64)
    undecided = passed + counts[VERDICTS.index("undecided")]
    return {
        "left": edges[:-1],
        "right": edges[1:],
        "zero": zero,
        "pass": passed,
        "undecided": undecided,
        "fail": undecided + counts[VERDICTS.index("fail")],
    }


@dataclass(frozen=True, eq=False)
class MapPlaces:
    """Where devices are drawn in the wafer map.

    Parameters
    ----------
    x, y : (B,) in units of the radius of a wafer.
    centres : name -> centre of each wafer; one with the name "" if all are on one.
    """

    x: FloatArray
    y: FloatArray
    centres: dict[str, tuple[float, float]]


def places(night: NightData, wafer: str) -> MapPlaces:
    """Wafers side by side, in rows; all on one if there are more than ``WAFERS``."""
    x, y = night.devices.number("die_x_mm"), night.devices.number("die_y_mm")
    radius = float(np.nanmax(np.hypot(x, y), initial=0.0)) * 1.15 if np.isfinite(x).any() else 1.0
    on = night.on(wafer)
    names = sorted((name for name in night.wafers.at(on).counts() if name), key=natural)
    if len(names) > WAFERS:
        return MapPlaces(x / radius, y / radius, {"": (0.0, 0.0)})
    across = max(1, math.ceil(math.sqrt(1.5 * len(names))))
    centres = {name: (_ACROSS * (k % across), -_DOWN * (k // across)) for k, name in enumerate(names)}
    words = np.array([centres.get(word, (np.nan, np.nan)) for word in night.wafers.words]).reshape(-1, 2)
    middle = words[night.wafers.codes]
    return MapPlaces(x / (radius or 1.0) + middle[:, 0], y / (radius or 1.0) + middle[:, 1], centres)


def _tooltips(drawn: figure, renderers: list[GlyphRenderer]) -> None:
    drawn.add_tools(HoverTool(renderers=renderers, tooltips=[("device", "@id"), ("", "@verdict")]))


def _marks(drawn: figure, source: ColumnDataSource, x: str, y: str, size: float) -> GlyphRenderer:
    factors = list(MARKERS)
    colour = CategoricalColorMapper(factors=factors, palette=[COLOURS[name] for name in factors])
    edge = CategoricalColorMapper(factors=factors, palette=[EDGES[name] for name in factors])
    shape = CategoricalMarkerMapper(factors=factors, markers=[MARKERS[name] for name in factors])
    return drawn.scatter(
        x, y, source=source, size=size, marker={"field": "verdict", "transform": shape},
        fill_color={"field": "verdict", "transform": colour}, line_color={"field": "verdict", "transform": edge},
        line_width=1.5, legend_field="verdict", fill_alpha=0.9, nonselection_alpha=0.3, selection_alpha=1.0,
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class WaferMap:
    """The figure of the wafers: devices by verdict, or by a number with its colour scale."""

    figure: figure
    outlines: ColumnDataSource
    verdicts: GlyphRenderer
    numbers: GlyphRenderer
    scale: LinearColorMapper
    bar: ColorBar


def wafer_map(source: ColumnDataSource) -> WaferMap:
    """A map of the drawn devices of ``source`` (mx, my, c, verdict, id)."""
    drawn = plot("Wafer map", "", "", height=400, tools="tap,box_select,lasso_select,reset", match_aspect=True)
    outlines = ColumnDataSource({"x": [], "y": [], "top": [], "name": []})
    drawn.circle(
        "x", "y", radius=1.05, source=outlines, fill_color=None, line_color=DRAWN, line_width=1,
        nonselection_line_alpha=1.0,
    )  # fmt: skip
    drawn.text(
        "x", "top", text="name", source=outlines, text_align="center", text_font_size="10px", text_color=DRAWN,
        nonselection_text_alpha=1.0,
    )  # fmt: skip
    verdicts = _marks(drawn, source, "mx", "my", 8)
    scale = LinearColorMapper(palette="Cividis256", nan_color=DRAWN)
    _legend_above(drawn)
    numbers = drawn.scatter(
        "mx", "my", source=source, size=9, marker="square", fill_color={"field": "c", "transform": scale},
        line_color=None, nonselection_alpha=0.3, selection_alpha=1.0,
    )  # fmt: skip
    bar = ColorBar(color_mapper=scale, width=10, title="", visible=False)
    drawn.add_layout(bar, "right")
    drawn.axis.visible = False
    drawn.grid.visible = False
    _tooltips(drawn, [verdicts, numbers])
    return WaferMap(drawn, outlines, verdicts, numbers, scale, bar)


def outlines_of(found: MapPlaces) -> dict[str, list[object]]:
    """Data of the outlines of wafers."""
    return {
        "x": [x for x, _ in found.centres.values()],
        "y": [y for _, y in found.centres.values()],
        "top": [y + 1.06 for _, y in found.centres.values()],
        "name": list(found.centres),
    }


def scatter(source: ColumnDataSource) -> figure:
    """Two quantities of the drawn devices of ``source`` (x, y, verdict, id)."""
    drawn = plot("Two quantities", "", "", height=380, tools="tap,box_select,lasso_select,reset")
    _tooltips(drawn, [_marks(drawn, source, "x", "y", 7)])
    drawn.legend.visible = False  # that of the wafer map serves both
    return drawn


@dataclass(frozen=True, eq=False)
class DeviceFigures:
    """Spectrum and residual of a device."""

    spectrum: figure
    residual: figure
    lines: ColumnDataSource
    band: ColumnDataSource


def device_figures() -> DeviceFigures:
    """Empty ones; fill their sources."""
    spectrum = plot("Spectrum", "frequency, Hz", "amplitude, V", height=240, y_axis_type="log", **_EMPTY)
    lines = ColumnDataSource({name: [] for name in ("f", "measured", "model", "residual", "floor")})
    for name, colour, dash in (
        ("measured", DRAWN, "solid"),
        ("model", COLOURS["pass"], "dashed"),
        ("residual", COLOURS["fail"], "solid"),
        ("floor", DRAWN, "dotted"),
    ):
        label = "noise" if name == "floor" else name
        spectrum.line("f", name, source=lines, line_color=colour, line_dash=dash, line_width=1.6, legend_label=label)
    _legend_above(spectrum)
    residual = plot("Residual", "time, s", "residual, sigma", height=200, **_EMPTY)
    band = ColumnDataSource({name: [] for name in ("t", "low", "high")})
    residual.varea("t", "low", "high", source=band, fill_color=COLOURS["fail"], fill_alpha=0.7)
    # Without a device there is nothing to draw.
    spectrum.visible = residual.visible = False
    return DeviceFigures(spectrum, residual, lines, band)


def fit_ranges(drawn: figure, x: FloatArray, *curves: FloatArray, log: bool = False) -> None:
    """The ranges of ``drawn`` to its curves against ``x``, with room; ``log``: decades, and no value at or below 0."""
    values = np.concatenate([curve[np.isfinite(curve) & ((curve > 0.0) | (not log))] for curve in curves])
    low, high = (float(values.min()), float(values.max())) if values.size else (0.1, 1.0)
    room = 0.05 * (high - low) or 1.0
    drawn.x_range.start, drawn.x_range.end = float(x[0]), float(x[-1])
    drawn.y_range.start, drawn.y_range.end = (0.7 * low, 1.4 * high) if log else (low - room, high + room)
    for axis in (drawn.x_range, drawn.y_range):
        axis.reset_start, axis.reset_end = axis.start, axis.end


def _legend_above(drawn: figure) -> None:
    """The legend above the figure, where it hides nothing."""
    drawn.legend.orientation = "horizontal"
    drawn.add_layout(drawn.legend[0], "above")


def axis_words(drawn: figure, x: str, y: str | None = None) -> None:
    """Label the axes with quantities."""
    drawn.xaxis.axis_label = quantity_words(x)
    if y is not None:
        drawn.yaxis.axis_label = quantity_words(y)
