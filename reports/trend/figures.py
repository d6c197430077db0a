"""Control charts: the value of each night with its limits, one panel a quantity."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import chain

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from ..html.style import ACCENT, BEFORE, INK, MUTED, RULE, Drawing, panels, style
from ..words.trend import axis_label, night_label
from .charted import YIELD
from .content import TrendChart

#: Nights that are named below a chart; more would overlap.
_NAMED = 4
#: Limits that are farther from the nights than so many times their span are not drawn: two nights may give 100 spans.
_NEAR = 6.0
_LIMITS = "#b9c3cc"


def control_charts(charts: Sequence[TrendChart], run_id: str, name: str = "control-charts") -> Drawing:
    """A panel for each chart, two in a row: band of the limits of a single night, intervals of the nights, alarms as crosses.

    ``run_id`` is the night that is judged, marked by a ring where a chart has it.
    """
    shown = [chart for chart in charts if chart.points]
    with style():
        rows = -(-len(shown) // 2)
        figure, grid = panels(rows, 2, 1.75, left=0.8, right=0.42, bottom=0.95, top=0.35, gap=0.85, between=0.62)
        for k, axes in enumerate(chain.from_iterable(grid)):
            if k < len(shown):
                _panel(axes, shown[k], run_id)
            else:
                axes.set_axis_off()
        figure.legend(handles=_handles(), loc="lower left", ncols=4, bbox_to_anchor=(0.06, 0.0), columnspacing=1.6)
        return Drawing(figure, name, "Control charts: value of each night, limits of a single night, alarms")


def _panel(axes: Axes, chart: TrendChart, run_id: str) -> None:
    scale = 100.0 if chart.name == YIELD else 1.0
    x = np.arange(len(chart.points), dtype=np.float64)
    rows = np.array(
        [(p.value, p.low, p.high, p.centre, p.low_limit, p.high_limit) for p in chart.points], dtype=np.float64
    ).T
    value, low, high, centre, lower, upper = scale * rows
    axes.fill_between(x, lower, upper, step="mid", color=RULE, alpha=0.75, lw=0)
    axes.step(x, lower, where="mid", color=_LIMITS, lw=1.0)
    axes.step(x, upper, where="mid", color=_LIMITS, lw=1.0)
    axes.plot(x, centre, color=MUTED, lw=0.9, ls=(0, (4, 2)))
    finite = np.isfinite(low) & np.isfinite(high)
    axes.vlines(x[finite], low[finite], high[finite], color=ACCENT, lw=2.2, alpha=0.4)
    axes.plot(x, value, color=ACCENT, lw=0.7, marker="o", ms=4.5, mec="white", mew=0.5)
    judged = np.array([point.run_id == run_id for point in chart.points])
    axes.plot(x[judged], value[judged], ls="none", marker="o", ms=8.5, mfc="none", mec=INK, mew=1.1)
    alarmed = np.array([bool(point.broken) for point in chart.points])
    axes.plot(x[alarmed], value[alarmed], ls="none", marker="X", ms=9, mfc=BEFORE, mec="white", mew=0.6)
    _window(axes, chart, value, low, high, lower, upper)
    axes.set_xlim(-0.6, len(x) - 0.4)
    step = max(1, math.ceil(len(x) / _NAMED))
    # Counted from tonight, so that the last night is always named.
    named = np.arange(len(x) - 1, -1, -step)[::-1]
    axes.set_xticks(named, [night_label(chart.points[k].created) for k in named])
    axes.tick_params(axis="x", labelsize=9)
    axes.set_title(axis_label(chart.name, chart.unit))
    axes.yaxis.set_major_locator(MaxNLocator(5))
    axes.grid(axis="y", color=RULE, lw=0.5)
    axes.set_axisbelow(True)


def _window(axes: Axes, chart: TrendChart, value: np.ndarray, *others: np.ndarray) -> None:
    """All nights are inside, and the latest limits where they do not dwarf them; wide intervals may leave the window."""
    low, high, lower, upper = others
    ends = list(value)
    spread = max(max(ends) - min(ends), 1e-9 * max(abs(max(ends)), 1e-9))
    near = [end for end in (*low, *high) if np.isfinite(end) and abs(end - value.mean()) < _NEAR * spread]
    ends += near
    spread = max(ends) - min(ends)
    limits = [end for end in (lower[-1], upper[-1]) if np.isfinite(end)]
    beyond = [end for end in limits if abs(end - value.mean()) > _NEAR * spread]
    ends += [end for end in limits if end not in beyond]
    margin = 0.06 * (max(ends) - min(ends)) or 0.5
    bottom, top = min(ends) - margin, max(ends) + margin
    if chart.name == YIELD:
        bottom, top = max(bottom, -3.0), min(top, 103.0)
    axes.set_ylim(bottom, top)
    if beyond:
        axes.set_title("limits beyond the chart", loc="right", fontsize=9, color=MUTED, fontweight="normal")


def _handles() -> list[Line2D | Patch]:
    return [
        Line2D([], [], color=ACCENT, lw=0.7, marker="o", ms=4.5, label="night, with its 95 % interval"),
        Line2D([], [], ls="none", marker="o", ms=8.5, mfc="none", mec=INK, label="this run"),
        Patch(fc=RULE, ec=_LIMITS, label="limits of one night, from those before it"),
        Line2D([], [], ls="none", marker="X", ms=9, mfc=BEFORE, mec="white", label="alarm"),
    ]
