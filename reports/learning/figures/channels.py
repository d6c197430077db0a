"""Errors record by record and channel by channel, before and after."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.lines import Line2D

from ...html.style import INK, MUTED, RULE, style, to_svg
from ...run.figures.states import AFTER, BEFORE
from .panels import log_ticks, panels, plain


@dataclass(frozen=True)
class ChannelError:
    """Error of one channel of one record; ``after`` is ``None`` where there is no second model."""

    record: str
    role: str
    channel: int
    before: float
    after: float | None


def channel_errors(rows: Sequence[ChannelError], senses: int, name: str = "channel-errors") -> str:
    """One line a record and channel, from before to after; noise is 1."""
    with style():
        longest = max((len(_record(row)) for row in rows), default=0)
        left = 0.4 + 0.085 * (min(longest, 48) + 7 * (senses > 1))
        figure, grid = panels(1, 1, 0.27 * len(rows), left=left, top=0.1)
        axes = grid[0][0]
        labels = []
        for k, row in enumerate(rows):
            both = [row.before, *([] if row.after is None else [row.after])]
            axes.plot(both, [-k] * len(both), color=RULE, lw=2.5, zorder=1)
            axes.plot([row.before], [-k], marker="s", ms=6, color=BEFORE, ls="none", zorder=3)
            if row.after is not None:
                axes.plot([row.after], [-k], marker="o", ms=6.5, color=AFTER, ls="none", zorder=4)
            first = k == 0 or rows[k - 1].record != row.record
            what = _record(row)[:48] if first else ""
            labels.append(f"{what}  sense {row.channel + 1}" if senses > 1 else what)
            if first and k:
                axes.axhline(0.5 - k, color="#eef1f3", lw=0.8, zorder=0)
        axes.axvline(1.0, color=INK, lw=1.0, ls=(0, (1, 1.5)))
        axes.set_yticks([-k for k in range(len(rows))], labels)
        axes.tick_params(axis="y", length=0)
        values = [v for row in rows for v in (row.before, row.after) if v is not None and np.isfinite(v) and v > 0.0]
        if values:
            axes.set_xscale("log")
            axes.set_xlim(min([0.9, *(0.9 * v for v in values)]), max([1.2, *(1.15 * v for v in values)]))
            log_ticks(axes.xaxis)
        axes.set_ylim(-len(rows) + 0.4, 0.6)
        axes.grid(axis="x", color=RULE, lw=0.5)
        axes.set_xlabel("error, rms residual / σ")
        selection = any(row.after is not None for row in rows)
        handles = [Line2D([], [], ls="none", marker="s", ms=6, color=BEFORE, label="before" if selection else "error")]
        if selection:
            handles.append(Line2D([], [], ls="none", marker="o", ms=6.5, color=AFTER, label="after"))
        handles.append(Line2D([], [], color=MUTED, lw=1.0, ls=(0, (1, 1.5)), label="noise"))
        figure.legend(handles=handles, loc="lower left", ncols=3)
        return to_svg(figure, name, "Error of every record and channel")


def _record(row: ChannelError) -> str:
    name = plain(row.record)
    return f"{name} (held out)" if row.role == "validate" else name
