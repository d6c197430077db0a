"""Figure of the amplitudes of free decays against time, as they were read."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from matplotlib.figure import Figure

from pipeline.experiment.envelopes import EnvelopeRecord

from ...html.style import AFTER, WIDTH, literal, style
from .tones import fitting_unit

_FIGURES = 8


def amplitudes_png(records: Sequence[EnvelopeRecord], path: Path) -> None:
    """Write the amplitude of each sense of each record against time to ``path`` (PNG), on a logarithmic scale.

    Raises
    ------
    OSError : the file cannot be written.
    """
    with style():
        amplitudes_figure(records).savefig(path, format="png", dpi=110)


def amplitudes_figure(records: Sequence[EnvelopeRecord]) -> Figure:
    """The amplitude of each sense of each record against time, on a logarithmic scale; at most eight."""
    rows = [(record, k) for record in records for k in range(record.amplitude_v.shape[1])][:_FIGURES]
    with style():
        figure = Figure(figsize=(WIDTH, 1.0 + 1.9 * len(rows)), layout="constrained")
        grid = figure.subplots(len(rows), 1, squeeze=False)[:, 0]
        for axes, (record, k) in zip(grid, rows):
            amplitude = record.amplitude_v[:, k]
            unit, factor = fitting_unit(float(amplitude.max()))
            axes.semilogy(record.time_s, amplitude * factor, ".", ms=3, color=AFTER)
            axes.set_ylabel(f"sense {k + 1}, {unit} peak")
            axes.set_title(literal(record.name))
        grid[-1].set_xlabel("time, s")
        return figure
