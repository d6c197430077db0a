"""Residual against the level of the response: noise is level 1 everywhere, a nonlinearity rises with the level."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from matplotlib.lines import Line2D

from pipeline.arrays import FloatArray

from ...html.style import INK, RULE, style, to_svg
from ...run.figures.states import AFTER, BEFORE
from .panels import log_ticks, panels


@dataclass(frozen=True, eq=False)
class LevelCurve:
    """One record, one channel, one model: level [V rms] and residual [sigmas rms]."""

    channel: int
    held_out: bool
    after: bool
    level_v: FloatArray
    residual: FloatArray


def level_plot(curves: Sequence[LevelCurve], senses: int, name: str = "level") -> str:
    """A panel a channel; each line is a record, held-out ones dashed."""
    with style():
        figure, rows = panels(1, senses, 2.6, top=0.1, sharey=True)
        grid = rows[0]
        for channel, axes in enumerate(grid):
            for curve in (one for one in curves if one.channel == channel and one.level_v.size):
                axes.plot(
                    curve.level_v,
                    curve.residual,
                    color=AFTER if curve.after else BEFORE,
                    lw=1.3,
                    ls=(0, (3, 1.5)) if curve.held_out else "-",
                    alpha=0.85,
                    zorder=3 if curve.after else 2,
                )
            axes.axhline(1.0, color=INK, lw=1.0, ls=(0, (1, 1.5)))
            if axes.lines[:-1]:
                axes.set(xscale="log", yscale="log")
                for axis in (axes.xaxis, axes.yaxis):
                    log_ticks(axis)
            axes.grid(color=RULE, lw=0.5)
            axes.set_xlabel(f"response of sense {channel + 1}, V rms" if senses > 1 else "response, V rms")
        grid[0].set_ylabel("residual, σ rms")
        states = sorted({curve.after for curve in curves})
        handles = [
            Line2D([], [], color=AFTER if s else BEFORE, lw=1.5, label="after" if s else "before")
            for s in (states if len(states) > 1 else ())
        ]
        handles += [
            Line2D([], [], color=INK, lw=1.1, label="fitted"),
            Line2D([], [], color=INK, lw=1.1, ls=(0, (3, 1.5)), label="held out"),
            Line2D([], [], color=INK, lw=1.0, ls=(0, (1, 1.5)), label="noise"),
        ]
        figure.legend(handles=handles, loc="lower left", ncols=5)
        return to_svg(figure, name, "Residual against the level of the response")
