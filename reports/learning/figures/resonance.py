"""Measured, model and residual spectra around a resonance, channel by channel, before and after."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, MaxNLocator, NullLocator

from ...html.style import INK, MUTED, RULE, style, to_svg
from ...run.figures.states import AFTER, BEFORE
from ..record_view import RecordSpectra
from .panels import panels

#: Decades below the noise floor that are shown.
_BELOW = 0.25


@dataclass(frozen=True, eq=False)
class ResonancePanel:
    """One model at one resonance: a title and its spectra; ``after`` chooses the colour of the residual."""

    title: str
    spectra: RecordSpectra
    after: bool = False


def resonance_plot(shown: Sequence[ResonancePanel], marks_hz: Sequence[float], name: str) -> str:
    """Rows are channels, columns what is ``shown``; ``marks_hz`` are drawn as ticks at the top."""
    senses = shown[0].spectra.measured.shape[1]
    with style():
        figure, grid = panels(senses, len(shown), 1.85, sharex=True, sharey="row", between=0.16)
        for column, panel in enumerate(shown):
            for row in range(senses):
                axes = grid[row][column]
                _panel(axes, panel, row)
                for mark in marks_hz:
                    axes.plot(
                        [mark, mark], [0.95, 1.0], transform=axes.get_xaxis_transform(), color=INK, lw=1.0, zorder=5
                    )
                if column == 0:
                    axes.set_ylabel(f"sense {row + 1}, V" if senses > 1 else "amplitude, V")
                if row == senses - 1:
                    axes.set_xlabel("frequency, Hz")
            grid[0][column].set_title(panel.title)
        figure.legend(handles=_handles(shown), loc="lower left", ncols=5, handlelength=1.6)
        return to_svg(figure, name, "Measured, model and residual spectra around a resonance")


def _panel(axes: Axes, panel: ResonancePanel, channel: int) -> None:
    s = panel.spectra
    axes.plot(s.frequency_hz, s.measured[:, channel], color="#9aa5b1", lw=3.6, solid_capstyle="round")
    axes.plot(s.frequency_hz, s.model[:, channel], color=INK, lw=1.1)
    axes.plot(s.frequency_hz, s.residual[:, channel], color=AFTER if panel.after else BEFORE, lw=1.4)
    floor = float(s.floor[channel])
    axes.set_yscale("log")
    top = float(max(s.measured[:, channel].max(), s.model[:, channel].max(), 1e-12))
    if np.isfinite(floor) and floor > 0.0:
        axes.axhline(floor, color=MUTED, lw=1.0, ls=(0, (4, 2)))
        axes.set_ylim(floor * _BELOW, max(top, 10.0 * floor) * 2.0)
    axes.set_xlim(float(s.frequency_hz[0]), float(s.frequency_hz[-1]))
    axes.yaxis.set_major_locator(LogLocator(numticks=6))
    axes.yaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_locator(MaxNLocator(6))
    axes.grid(axis="y", color=RULE, lw=0.5)


def _handles(shown: Sequence[ResonancePanel]) -> list[Line2D]:
    residuals = [
        Line2D([], [], color=AFTER if after else BEFORE, lw=1.4, label=f"residual {title}".strip())
        for after, title in sorted({(panel.after, panel.title) for panel in shown})
    ]
    return [
        Line2D([], [], color="#9aa5b1", lw=3.6, label="measured"),
        Line2D([], [], color=INK, lw=1.1, label="model"),
        *residuals,
        Line2D([], [], color=MUTED, lw=1.0, ls=(0, (4, 2)), label="noise"),
    ]
