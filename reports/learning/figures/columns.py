"""Figure of the records of a campaign as they were read: each channel against time, and its amplitude against frequency."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pipeline.arrays import FloatArray
from pipeline.experiment.record import Record

from ...html.style import ACCENT, BEFORE, MUTED, literal, style

#: Points of a trace that a figure of 10 inches can show.
_POINTS = 2000
_CHANNELS = 8
_RECORDS = 6


def columns_png(records: tuple[Record, ...], path: Path) -> None:
    """Write the figure of ``records`` to ``path`` (PNG).

    Raises
    ------
    OSError : the file cannot be written.
    """
    with style():
        columns_figure(records).savefig(path, format="png", dpi=110)


def columns_figure(records: tuple[Record, ...]) -> Figure:
    """The figure of ``records``; at most the first six records and eight channels of each."""
    rows = [
        (record, kind, k)
        for record in records[:_RECORDS]
        for kind, count in (("drive", record.drive_v.shape[1]), ("sense", record.sense_v.shape[1]))
        for k in range(min(count, _CHANNELS // 2))
    ]
    with style():
        figure = Figure(figsize=(10.25, 1.2 + 1.35 * len(rows)), layout="constrained")
        grid = figure.subplots(len(rows), 2, squeeze=False, width_ratios=(1.4, 1.0))
        for (time_axes, spectrum_axes), (record, kind, k) in zip(grid, rows):
            values = (record.drive_v if kind == "drive" else record.sense_v)[:, k]
            colour = BEFORE if kind == "drive" else ACCENT
            unit = record.units.get(f"{kind}{k + 1}_V", "V")
            _trace(time_axes, values, record.sample_rate_hz, colour)
            _spectrum(spectrum_axes, values, record.sample_rate_hz, colour)
            time_axes.set_ylabel(f"{kind}{k + 1} [{unit}]")
            time_axes.set_title(literal(record.name) if (kind, k) == _first(record) else "")
        grid[-1][0].set_xlabel("time [s]")
        grid[-1][1].set_xlabel("frequency [Hz], amplitude")
        return figure


def _first(record: Record) -> tuple[str, int]:
    return ("drive", 0) if record.drive_v.shape[1] else ("sense", 0)


def _trace(axes: Axes, values: FloatArray, rate_hz: float, colour: str) -> None:
    """The trace; of long records the range of each piece, so that no peak is lost."""
    count = values.size
    if count <= _POINTS:
        axes.plot(np.arange(count) / rate_hz, values, color=colour, lw=0.7)
        return
    per = -(-count // _POINTS)
    padded = np.concatenate([values, np.full(-count % per, values[-1])]).reshape(-1, per)
    time_s = np.arange(padded.shape[0]) * per / rate_hz
    axes.fill_between(time_s, padded.min(axis=1), padded.max(axis=1), color=colour, lw=0.3)


def _spectrum(axes: Axes, values: FloatArray, rate_hz: float, colour: str) -> None:
    """Amplitude [unit of the channel] against frequency, Hann window; of long records the largest of each piece."""
    window = np.hanning(values.size)
    spectrum = np.abs(np.fft.rfft((values - values.mean()) * window)) * 2.0 / window.sum()
    frequency_hz = np.arange(spectrum.size) * rate_hz / values.size
    per = max(spectrum.size // _POINTS, 1)
    kept = spectrum.size // per * per
    amplitude, at = spectrum[:kept].reshape(-1, per).max(axis=1), frequency_hz[:kept:per]
    if not np.any(amplitude[1:] > 0.0):
        axes.text(0.5, 0.5, "constant", transform=axes.transAxes, ha="center", va="center", color=MUTED)
        axes.set_xticks([])
        axes.set_yticks([])
        return
    axes.semilogy(at[1:], np.maximum(amplitude[1:], 1e-9 * amplitude[1:].max()), color=colour, lw=0.7)
