"""Pictures of the manual, as SVG files: they are drawn when it is built."""

from __future__ import annotations

import io
import re
import warnings
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle

from pipeline.arrays import FloatArray
from reports.html.style import AFTER, BEFORE, MUTED, log_ticks, style

from .patterns import Pattern, WaferPicture
from .signatures import SIGMA_V, EffectSignature

#: Width of a picture [inch]: that of the text of a page.
_WIDE = 7.8
_AROUND_HZ = (500.0, 640.0)
_BINS = 240
_PIECES = 100
_LOOKS: tuple[dict[str, Any], ...] = (
    {"label": "record without the effect", "color": "#b3bcc6", "linewidth": 1.4},
    {"label": "change by the effect", "color": BEFORE, "linewidth": 1.6},
    {"label": "left after a fit of the plant", "color": AFTER, "linewidth": 1.2, "linestyle": (0, (4, 1.5))},
)


def signature_picture(found: EffectSignature) -> str:
    """Spectra around the resonances and over the full band, and the change over time, as the text of an SVG file."""
    with style():
        figure = Figure(figsize=(_WIDE, 5.2))
        (near, time), (wide, other) = figure.subplots(2, 2)
        other.remove()
        wide.set_subplotspec(wide.get_subplotspec().get_gridspec()[1, :])
        figure.subplots_adjust(left=0.09, right=0.97, top=0.95, bottom=0.2, hspace=0.5, wspace=0.3)
        for axes, limits, title in (
            (near, _AROUND_HZ, "Around the modes"),
            (wide, (0.0, found.rate_hz / 2.0), "Full band"),
        ):
            _spectra(axes, found, limits)
            axes.set(title=title, xlabel="frequency [Hz]", ylabel="amplitude [mV]")
        _over_time(time, found)
        figure.legend(*near.get_legend_handles_labels(), loc="lower center", ncols=2)
        return svg_file(figure, found.effect)


def svg_file(figure: Figure, salt: str) -> str:
    """The figure as the text of an SVG file; the same figure gives the same bytes."""
    buffer = io.StringIO()
    with warnings.catch_warnings():
        # Text stays text in an SVG, so a letter that matplotlib's own font lacks does no harm.
        warnings.filterwarnings("ignore", message="Glyph")
        figure.savefig(buffer, format="svg", metadata={"Date": None}, transparent=True)
    text = re.sub(r"<metadata>.*?</metadata>|<!--.*?-->|<!DOCTYPE.*?>", "", buffer.getvalue(), flags=re.S)
    return re.sub(r'(\s(?:d|x|y)=")([^"]*)(")', lambda m: m[1] + re.sub(r"(\d\.\d\d)\d+", r"\1", m[2]) + m[3], text)


def _spectra(axes: Axes, found: EffectSignature, limits_hz: tuple[float, float]) -> None:
    for values, look in zip((found.record, found.change, found.left), _LOOKS):
        axes.plot(*_spectrum(values, found.rate_hz, limits_hz), **look)
    window = np.hanning(len(found.record))
    noise = 2e3 * SIGMA_V * np.sqrt(found.record.shape[1] * np.sum(window**2)) / window.sum()
    _level(axes, noise)
    axes.set_xlim(*limits_hz)


def _level(axes: Axes, noise: float) -> None:
    """The level of the noise [mV], and the axis from well below it."""
    axes.set_yscale("log")
    axes.set_ylim(noise / 30.0, axes.get_ylim()[1])
    log_ticks(axes.yaxis)
    axes.axhline(noise, color=MUTED, linewidth=0.9, linestyle=(0, (1, 1.5)), label=f"noise of {1e3 * SIGMA_V:g} mV")


def _spectrum(values: FloatArray, rate_hz: float, limits_hz: tuple[float, float]) -> tuple[FloatArray, FloatArray]:
    """Amplitude [mV] of both channels together against frequency [Hz]; the largest value of each of a few bins."""
    window = np.hanning(len(values))[:, None]
    amplitude = 2e3 * np.linalg.norm(np.fft.rfft(values * window, axis=0), axis=1) / window.sum()
    frequency = np.fft.rfftfreq(len(values), 1.0 / rate_hz)
    inside = (frequency >= limits_hz[0]) & (frequency <= limits_hz[1])
    pieces = min(_BINS, int(inside.sum()))
    f = [part.mean() for part in np.array_split(frequency[inside], pieces)]
    a = [part.max() for part in np.array_split(amplitude[inside], pieces)]
    return np.array(f), np.maximum(np.array(a), 1e-12)


def _over_time(axes: Axes, found: EffectSignature) -> None:
    middle = (np.arange(_PIECES) + 0.5) * len(found.record) / _PIECES / found.rate_hz
    for values, look in zip((found.record, found.change, found.left), _LOOKS):
        rms = [1e3 * np.sqrt(np.mean(piece**2)) for piece in np.array_split(values, _PIECES)]
        axes.plot(middle, np.maximum(rms, 1e-12), **look)
    _level(axes, 1e3 * SIGMA_V)
    axes.set(title="Over time", xlabel="time [s]", ylabel="rms [mV]")


def pattern_picture(found: Pattern) -> str:
    """Maps of wafers, and the shares of the spreads of quantities where they are known, as the text of an SVG file."""
    with style():
        rows = len(found.shares)
        heights = (2.3, 0.7 + 0.22 * rows)
        figure = Figure(figsize=(_WIDE, sum(heights) if rows else heights[0]), layout="constrained")
        grid = figure.add_gridspec(2 if rows else 1, len(found.maps), height_ratios=heights if rows else heights[:1])
        largest = max(float(np.max(np.abs(one.values))) for one in found.maps) or 1.0
        for k, one in enumerate(found.maps):
            shown = _dies(figure.add_subplot(grid[0, k]), one, found.radius, largest)
        figure.colorbar(shown, ax=figure.axes, shrink=0.8, pad=0.02)
        figure.suptitle(found.what, fontsize="medium")
        if rows:
            axes = figure.add_subplot(grid[1, :])
            names, values = zip(*reversed(found.shares))
            axes.barh(names, [100.0 * value for value in values], color=AFTER, height=0.65)
            axes.set(xlabel="rms change, as a share of the spread of the quantity in the population [%]")
        return svg_file(figure, found.name)


def _dies(axes: Axes, wafer: WaferPicture, radius: float, largest: float) -> PatchCollection:
    """Every die of a wafer as a rectangle, coloured by its value."""
    width, height = _pitch(wafer.x), _pitch(wafer.y)
    dies = [Rectangle((x - width / 2.0, y - height / 2.0), width, height) for x, y in zip(wafer.x, wafer.y)]
    shown = PatchCollection(dies, cmap="PuOr", norm=Normalize(-largest, largest), linewidths=0, antialiaseds=False)
    shown.set_array(wafer.values)
    axes.add_collection(shown)
    axes.add_patch(Circle((0.0, 0.0), radius, fill=False, edgecolor=MUTED, linewidth=0.8))
    around = 1.03 * radius
    axes.set(title=wafer.title, aspect="equal", xticks=(), yticks=(), xlim=(-around, around), ylim=(-around, around))
    axes.set_frame_on(False)
    return shown


def _pitch(places: FloatArray) -> float:
    """Distance of neighbouring dies along one axis."""
    steps = np.diff(np.unique(np.round(places, 6)))
    return float(steps.min()) if len(steps) else 1.0
