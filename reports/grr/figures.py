"""AIAG's charts of a gauge R&R, one figure a quantity."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from pipeline.arrays import FloatArray, IntArray

from ..html.style import ACCENT, BEFORE, INK, MUTED, POINTS, RULE, Drawing, literal, panels, style
from ..words.gauge import BARS, axis_label, chart_titles, figure_words
from .content import GaugeChart, mean_limits, sd_limits

#: Colour and marker of each tester, in turn: Okabe and Ito's.
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#7a5c00", "#56b4e9")
_MARKERS = ("o", "X", "s", "D", "^", "v")
#: Parts that are named below a chart, testers in a legend; more would overlap.
_NAMED, _LEGEND = 16, 6


def gauge_figure(chart: GaugeChart, name: str) -> Drawing:
    """Six panels: variation, interaction, sd of repeats, by part, means of parts, by tester."""
    titles = chart_titles()
    with style():
        figure, grid = panels(3, 2, 2.25, left=1.25, right=0.15, bottom=0.6, top=0.35, gap=0.85, between=0.85)
        draw = (_variation, _interaction, _repeats, _by_part, _means, _by_tester)
        for axes, title, panel in zip([one for row in grid for one in row], titles, draw, strict=True):
            axes.set_title(title)
            panel(axes, chart)
        return Drawing(figure, name, figure_words(chart.study))


def _variation(axes: Axes, chart: GaugeChart) -> None:
    """Bars of % study variation and % tolerance, with their intervals as lines."""
    rows = [chart.study.component(name) for name in BARS]
    with_tolerance = rows[0].tolerance is not None
    y = np.arange(len(rows), dtype=np.float64)[::-1]
    height = 0.36 if with_tolerance else 0.55
    shown = [("% study variation", [one.study for one in rows], ACCENT, "", 0.5 * height if with_tolerance else 0.0)]
    if with_tolerance:
        tolerances = [one.tolerance for one in rows if one.tolerance is not None]
        shown.append(("% tolerance", tolerances, BEFORE, "////", -0.5 * height))
    for label, shares, colour, hatch, shift in shown:
        value = np.array([one.value for one in shares])
        axes.barh(y + shift, value, height=height, color=colour, alpha=0.75, hatch=hatch, ec="white", lw=0, label=label)
        axes.hlines(y + shift, [one.low for one in shares], [min(one.high, 1e9) for one in shares], color=INK, lw=1.1)
    # An interval of a few degrees of freedom may end far away; the estimates must stay readable.
    axes.set_xlim(0.0, 1.3 * max(100.0, max(float(one.value) for _, shares, _, _, _ in shown for one in shares)))
    axes.set_yticks(y, [name if name != "part" else "part to part" for name in BARS])
    axes.set_xlabel("%")
    if with_tolerance:
        axes.legend(loc="upper right", fontsize=9, bbox_to_anchor=(1.03, 1.06))


def _interaction(axes: Axes, chart: GaugeChart) -> None:
    """Mean of each part by each tester; parallel lines: no interaction."""
    cells = chart.cells
    for k, label in enumerate(chart.testers):
        own = cells.tester == k
        axes.plot(
            cells.part[own],
            cells.mean[own],
            color=_COLOURS[k % len(_COLOURS)],
            marker=_MARKERS[k % len(_MARKERS)],
            ms=4.0,
            lw=1.0,
            alpha=0.9,
            label=literal(label or "one tester"),
        )
    _parts_below(axes, chart)
    if len(chart.testers) <= _LEGEND:
        axes.legend(loc="best", fontsize=9, ncols=min(len(chart.testers), 3), columnspacing=1.0, handletextpad=0.4)


def _repeats(axes: Axes, chart: GaugeChart) -> None:
    """sd of the repeats of each part by each tester, against the limits that the repeatability gives."""
    sigma = chart.study.component("repeatability").sd.value
    low, centre, high = sd_limits(sigma, chart.cells.df)
    if not (chart.cells.df > 0).any():
        axes.text(0.5, 0.5, "no repeat within a session", transform=axes.transAxes, ha="center", color=MUTED)
    _in_turn(axes, chart, chart.cells.sd, low, centre, high)
    axes.set_ylim(bottom=0.0)


def _means(axes: Axes, chart: GaugeChart) -> None:
    """Mean of each part by each tester; most should lie beyond limits that know the repeatability alone."""
    low, high = mean_limits(chart.study, chart.cells.count)
    _in_turn(axes, chart, chart.cells.mean, low, np.full(low.size, chart.study.mean), high)


def _in_turn(
    axes: Axes, chart: GaugeChart, value: FloatArray, low: FloatArray, centre: FloatArray, high: FloatArray
) -> None:
    """A chart of the cells, tester by tester, with limits."""
    cells, x = chart.cells, np.arange(value.size, dtype=np.float64)
    axes.fill_between(x, low, high, step="mid", color=RULE, alpha=0.75, lw=0)
    axes.step(x, centre, where="mid", color=MUTED, lw=0.9, ls=(0, (4, 2)))
    with np.errstate(invalid="ignore"):
        beyond = (value < low) | (value > high)
    middles, names = [], []
    for k, label in enumerate(chart.testers):
        own = np.flatnonzero(cells.tester == k)
        colour = _COLOURS[k % len(_COLOURS)]
        axes.plot(x[own], value[own], color=colour, lw=0.8, marker=_MARKERS[k % len(_MARKERS)], ms=4.0)
        axes.plot(
            x[own][beyond[own]], value[own][beyond[own]], ls="none", marker="o", ms=9, mfc="none", mec=INK, mew=0.9
        )
        if k:
            axes.axvline(x[own[0]] - 0.5, color=MUTED, lw=0.7)
        middles.append(float(x[own].mean()))
        names.append(literal(label or "one tester"))
    if len(names) <= _NAMED:
        axes.set_xticks(middles, names)
    else:
        axes.set_xticks([])
    axes.set_xlabel("each part, by tester")
    axes.set_ylabel(axis_label(chart.study))


def _values(axes: Axes, chart: GaugeChart, x: FloatArray) -> None:
    """The values of all testers at ``x`` (n,), in the colour and with the marker of each; a sample where they are many."""
    data, rows = chart.data, _some(chart.data.value.size)
    for k in range(len(chart.testers)):
        own = rows[data.tester[rows] == k]
        axes.plot(
            x[own],
            data.value[own],
            ls="none",
            color=_COLOURS[k % len(_COLOURS)],
            marker=_MARKERS[k % len(_MARKERS)],
            ms=3.2,
            alpha=0.65,
            mew=0,
        )


def _by_part(axes: Axes, chart: GaugeChart) -> None:
    data = chart.data
    _values(axes, chart, data.part + _beside(data.tester, len(chart.testers)))
    count = np.bincount(data.part)
    axes.plot(np.arange(count.size), np.bincount(data.part, data.value) / count, color=INK, lw=0.9)
    _parts_below(axes, chart)


def _by_tester(axes: Axes, chart: GaugeChart) -> None:
    data = chart.data
    _values(axes, chart, data.tester + 0.6 * (data.part / max(len(chart.parts) - 1, 1) - 0.5))
    count = np.bincount(data.tester)
    axes.plot(np.arange(count.size), np.bincount(data.tester, data.value) / count, color=INK, lw=0.9, marker="_", ms=16)
    axes.set_xlim(-0.6, len(chart.testers) - 0.4)
    if len(chart.testers) <= _NAMED:
        axes.set_xticks(range(len(chart.testers)), [literal(one or "one tester") for one in chart.testers])
    else:
        axes.set_xticks([])
    axes.set_xlabel("tester; within it, parts from left to right")
    axes.set_ylabel(axis_label(chart.study))


def _parts_below(axes: Axes, chart: GaugeChart) -> None:
    if len(chart.parts) <= _NAMED:
        longest = max(map(len, chart.parts), default=0)
        turned = 90 if longest * len(chart.parts) > 60 else 0
        axes.set_xticks(range(len(chart.parts)), [literal(one[:12]) for one in chart.parts], rotation=turned)
    else:
        axes.set_xticks([])
    axes.set_xlabel("part")
    axes.set_ylabel(axis_label(chart.study))


def _beside(tester: IntArray, testers: int) -> FloatArray:
    """Where the points of each tester (n,) lie beside the place of a part."""
    return np.asarray(0.5 * ((tester + 0.5) / testers - 0.5))


def _some(count: int) -> IntArray:
    """All rows, or evenly spaced ones: more would only enlarge the page."""
    if count <= POINTS:
        return np.arange(count)
    return np.unique(np.linspace(0, count - 1, POINTS).astype(np.int64))
