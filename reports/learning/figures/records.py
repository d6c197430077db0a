"""Figures of records with the first and the last model: spectra, spectrograms, residual by level, errors by channel."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.image import AxesImage
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, MaxNLocator, NullLocator

from pipeline.arrays import FloatArray

from ...html.style import AFTER, BEFORE, INK, MUTED, RULE, WIDTH, Drawing, literal, log_ticks, panels, style
from ...words.numbers import number
from ...words.quantities import listed
from ..record_view import (
    FrequencyWindow,
    RecordPair,
    RecordSpectra,
    RecordView,
    TimeFrequency,
    by_level,
    drive_band,
    drive_frequency,
    pictured,
    record_pairs,
    resonance_windows,
    spectra,
    time_frequency,
)

_MEASURED = "#9aa5b1"
_DOTTED, _DASHED = (0, (1, 1.5)), (0, (4, 2))
_HELD_OUT = (0, (3, 1.5))
#: Step of the colour scale [dB]; coarse steps keep the picture small.
_STEP_DB = 5.0


@dataclass(frozen=True)
class Picture:
    """A figure of one record: name of the record, a note on it, what is shown, and the figure."""

    record: str
    note: str
    what: str
    drawing: Drawing


@dataclass(frozen=True)
class RecordFigures:
    """All figures of records; empty or ``None`` where nothing can be drawn."""

    resonances: tuple[Picture, ...]
    spectrograms: tuple[Picture, ...]
    level: Drawing | None
    channels: Drawing | None


def record_figures(
    before: Sequence[RecordView], after: Sequence[RecordView] | None, parameters: Mapping[str, float]
) -> RecordFigures:
    """All figures of records.

    Parameters
    ----------
    before, after : the records with the first and with the last model.
    parameters : of the last model; its resonances (f1_hz [Hz], ..) are pictured.
    """
    pairs = record_pairs(before, after)
    chosen = pictured(pairs)
    windows = resonance_windows(parameters, [view for view, _ in pairs])
    return RecordFigures(
        resonances=_pictures(
            (
                pair,
                f"around {listed([number(one) for one in window.centres_hz])} Hz",
                _resonance(pair, window, f"{k}-{j}"),
            )
            for k, pair in enumerate(chosen[:2])
            for j, window in enumerate(windows)
        ),
        spectrograms=_pictures(
            (pair, "over time and frequency", _spectrogram(pair, str(k))) for k, pair in enumerate(chosen)
        ),
        level=_levels(pairs) if pairs else None,
        channels=_channels(pairs) if pairs else None,
    )


def _pictures(drawn: Iterable[tuple[RecordPair, str, Drawing | None]]) -> tuple[Picture, ...]:
    return tuple(
        Picture(pair[0].name, " (held out)" if pair[0].role == "validate" else "", what, drawing)
        for pair, what, drawing in drawn
        if drawing is not None
    )


def _models(pair: RecordPair) -> list[tuple[RecordView, str, str]]:
    """View, title and colour of each model; a single model has no title."""
    first, last = pair
    return [(first, "", BEFORE)] if last is None else [(first, "before", BEFORE), (last, "after", AFTER)]


def _line(label: str, colour: str, width: float = 1.4, style: Any = "-") -> Line2D:
    return Line2D([], [], color=colour, lw=width, ls=style, label=label)


def _resonance(pair: RecordPair, window: FrequencyWindow, name: str) -> Drawing | None:
    """Rows are channels, columns the models; ticks at the top mark the resonances."""
    shown = [(spectra(view, window.band_hz), title, colour) for view, title, colour in _models(pair)]
    if not all(found.frequency_hz.size > 1 for found, _, _ in shown):
        return None
    senses = pair[0].senses
    with style():
        figure, grid = panels(senses, len(shown), 1.85, sharex=True, sharey="row", between=0.16)
        for column, (found, title, colour) in enumerate(shown):
            for row in range(senses):
                axes = grid[row][column]
                _spectra(axes, found, row, colour)
                for mark in window.centres_hz:
                    top = axes.get_xaxis_transform()
                    axes.plot([mark, mark], [0.95, 1.0], transform=top, color=INK, lw=1.0, zorder=5)
                if column == 0:
                    axes.set_ylabel(f"sense {row + 1}, V" if senses > 1 else "amplitude, V")
            grid[-1][column].set_xlabel("frequency, Hz")
            grid[0][column].set_title(title)
        handles = [_line("measured", _MEASURED, 3.6), _line("model", INK, 1.1)]
        handles += [_line(f"residual {title}".strip(), colour) for _, title, colour in shown]
        handles.append(_line("noise", MUTED, 1.0, _DASHED))
        figure.legend(handles=handles, loc="lower left", ncols=5, handlelength=1.6)
        return Drawing(figure, f"resonance-{name}", "Measured, model and residual spectra around a resonance")


def _spectra(axes: Axes, found: RecordSpectra, channel: int, colour: str) -> None:
    measured, model = found.measured[:, channel], found.model[:, channel]
    axes.plot(found.frequency_hz, measured, color=_MEASURED, lw=3.6, solid_capstyle="round")
    axes.plot(found.frequency_hz, model, color=INK, lw=1.1)
    axes.plot(found.frequency_hz, found.residual[:, channel], color=colour, lw=1.4)
    floor = float(found.floor[channel])
    axes.set_yscale("log")
    if np.isfinite(floor) and floor > 0.0:
        axes.axhline(floor, color=MUTED, lw=1.0, ls=_DASHED)
        axes.set_ylim(0.25 * floor, max(float(measured.max()), float(model.max()), 10.0 * floor) * 2.0)
    axes.set_xlim(float(found.frequency_hz[0]), float(found.frequency_hz[-1]))
    axes.yaxis.set_major_locator(LogLocator(numticks=6))
    axes.yaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_locator(MaxNLocator(6))
    axes.grid(axis="y", color=RULE, lw=0.5)


def _spectrogram(pair: RecordPair, name: str) -> Drawing | None:
    """Rows are the full band and the band of the drive, columns the models; white is the noise level."""
    models = _models(pair)
    nyquist = 0.5 * pair[0].sample_rate_hz
    low, high = drive_band(pair[0])
    room = max(0.2 * (high - low), pair[0].resolution_hz)
    near = (max(low - room, 0.0), min(high + room, nyquist))
    bands = [("full band, Hz", (0.0, nyquist), 120.0)]
    if near[1] - near[0] < 0.7 * nyquist:
        bands.append(("band of the drive, Hz", near, 30.0))
    rows = [(label, band, [time_frequency(view, parts, band) for view, _, _ in models]) for label, band, parts in bands]
    rows = [row for row in rows if all(found.over_noise_db.size for found in row[2])]
    if not rows:
        return None
    top = max(float(np.quantile(found.over_noise_db, 0.999)) for _, _, pictures in rows for found in pictures)
    ceiling = float(np.clip(_STEP_DB * np.ceil(top / _STEP_DB), 15.0, 80.0))
    colours, drives = _scale(round(ceiling / _STEP_DB)), drive_frequency(pair[0])
    with style():
        figure, grid = panels(
            len(rows), len(models), 2.1, left=0.85, right=1.05, between=0.18, gap=0.2, sharex=True, sharey="row"
        )
        for k, (label, band, pictures) in enumerate(rows):
            for axes, found in zip(grid[k], pictures, strict=True):
                image = _image(axes, found, ceiling, colours)
                _harmonics(axes, *drives, band)
                axes.set_ylim(*band)
            grid[k][0].set_ylabel(label)
        for axes, (_, title, _) in zip(grid[0], models, strict=True):
            axes.set_title(title)
        for axes in grid[-1]:
            axes.set_xlabel("time, s")
        height = figure.get_size_inches()[1]
        place = figure.add_axes((1.0 - 0.9 / WIDTH, 0.95 / height, 0.14 / WIDTH, 1.0 - 1.27 / height))
        figure.colorbar(image, cax=place, ticks=np.arange(0.0, ceiling + 1.0, _STEP_DB)).set_label(
            "residual above the noise, dB"
        )
        if drives[1].shape[0]:
            handles = [_line("drive frequency", AFTER, 1.3), _line("its harmonics", AFTER, 0.9, (0, (2, 2)))]
            figure.legend(handles=handles, loc="lower left", ncols=2)
        return Drawing(figure, f"spectrogram-{name}", "Residual over time and frequency in units of the noise")


def _scale(steps: int) -> ListedColormap:
    """White for the noise, then darker in steps."""
    shades = matplotlib.colormaps["magma_r"](np.linspace(0.12, 1.0, steps - 1))
    return ListedColormap(["white", *(tuple(shade) for shade in shades)])


def _image(axes: Axes, found: TimeFrequency, ceiling: float, colours: ListedColormap) -> AxesImage:
    def ends(x: FloatArray) -> tuple[float, float]:
        half = 0.5 * float(x[1] - x[0]) if x.size > 1 else 0.5
        return float(x[0]) - half, float(x[-1]) + half

    return axes.imshow(
        np.clip(found.over_noise_db, 0.0, ceiling),
        origin="lower",
        aspect="auto",
        interpolation="none",
        cmap=colours,
        vmin=0.0,
        vmax=ceiling,
        extent=(*ends(found.time_s), *ends(found.frequency_hz)),
    )


def _harmonics(axes: Axes, times_s: FloatArray, drives_hz: FloatArray, band_hz: tuple[float, float]) -> None:
    for drive in drives_hz:
        for order in range(1, 6):
            line = order * drive
            inside = np.where((line >= band_hz[0]) & (line <= band_hz[1]), line, np.nan)
            if np.isfinite(inside).any():
                width, dashes = (1.3, "-") if order == 1 else (0.9, (0, (2, 2)))
                axes.plot(times_s, inside, color=AFTER, lw=width, ls=dashes, alpha=0.85)


def _levels(pairs: Sequence[RecordPair]) -> Drawing | None:
    """A panel for each channel, a line for each record and model; held-out records are dashed."""
    senses = pairs[0][0].senses
    with style():
        figure, rows = panels(1, senses, 2.6, top=0.1, sharey=True)
        for channel, axes in enumerate(rows[0]):
            for pair in pairs:
                for order, (view, _, colour) in enumerate(_models(pair)):
                    level, residual = by_level(view, channel) if channel < view.senses else (np.zeros(0), np.zeros(0))
                    dashes = _HELD_OUT if view.role == "validate" else "-"
                    if level.size:
                        axes.plot(level, residual, color=colour, lw=1.3, ls=dashes, alpha=0.85, zorder=2 + order)
            axes.axhline(1.0, color=INK, lw=1.0, ls=_DOTTED)
            if len(axes.lines) > 1:
                axes.set(xscale="log", yscale="log")
                log_ticks(axes.xaxis)
                log_ticks(axes.yaxis)
            axes.grid(color=RULE, lw=0.5)
            axes.set_xlabel(f"response of sense {channel + 1}, V rms" if senses > 1 else "response, V rms")
        if not any(len(axes.lines) > 1 for axes in rows[0]):
            return None
        rows[0][0].set_ylabel("residual, σ rms")
        both = any(last is not None for _, last in pairs)
        handles = [_line("before", BEFORE, 1.5), _line("after", AFTER, 1.5)] if both else []
        handles += [_line("fitted", INK, 1.1), _line("held out", INK, 1.1, _HELD_OUT)]
        figure.legend(handles=[*handles, _line("noise", INK, 1.0, _DOTTED)], loc="lower left", ncols=5)
        return Drawing(figure, "level", "Residual against the level of the response")


def _channels(pairs: Sequence[RecordPair]) -> Drawing:
    """One line for each record and channel, from the error of the first to that of the last model; 1 is the noise."""
    labels: list[str] = []
    rows: list[tuple[float, float]] = []
    for first, last in pairs:
        name = f"{literal(first.name)[:48]} (held out)" if first.role == "validate" else literal(first.name)[:48]
        after = np.full(first.senses, np.nan) if last is None else last.channel_errors()
        for k, error in enumerate(first.channel_errors()):
            rows.append((float(error), float(after[k])))
            labels.append(f"{'' if k else name}  sense {k + 1}" if first.senses > 1 else name)
    places = [-k for k in range(len(rows))]
    known = [value for row in rows for value in row if np.isfinite(value) and value > 0.0]
    with style():
        left = 0.4 + 0.085 * max(len(label) for label in labels)
        figure, grid = panels(1, 1, 0.27 * len(rows), left=left, top=0.1)
        axes = grid[0][0]
        for y, row in zip(places, rows):
            axes.plot(row, [y, y], color=RULE, lw=2.5, zorder=1)
            axes.plot(row[0], y, marker="s", ms=6, color=BEFORE, ls="none", zorder=3)
            axes.plot(row[1], y, marker="o", ms=6.5, color=AFTER, ls="none", zorder=4)
        for y, label in zip(places[1:], labels[1:]):
            if not label.startswith("  "):
                axes.axhline(y + 0.5, color="#eef1f3", lw=0.8, zorder=0)
        axes.axvline(1.0, color=INK, lw=1.0, ls=_DOTTED)
        axes.set_yticks(places, labels)
        axes.tick_params(axis="y", length=0)
        if known:
            axes.set_xscale("log")
            axes.set_xlim(0.9 * min(1.0, *known), max(1.2, 1.15 * max(known)))
            log_ticks(axes.xaxis)
        axes.set_ylim(-len(rows) + 0.4, 0.6)
        axes.grid(axis="x", color=RULE, lw=0.5)
        axes.set_xlabel("error, rms residual / σ")
        both = any(last is not None for _, last in pairs)
        handles = [Line2D([], [], ls="none", marker="s", ms=6, color=BEFORE, label="before" if both else "error")]
        if both:
            handles.append(Line2D([], [], ls="none", marker="o", ms=6.5, color=AFTER, label="after"))
        figure.legend(handles=[*handles, _line("noise", MUTED, 1.0, _DOTTED)], loc="lower left", ncols=3)
        return Drawing(figure, "channel-errors", "Error of every record and channel")
