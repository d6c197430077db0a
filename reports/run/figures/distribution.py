"""Distributions of quantities with their limits: histograms, theta as an axis, and the anisotropy plane."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.projections.polar import PolarAxes
from matplotlib.ticker import MaxNLocator

from pipeline.arrays import FloatArray

from ...coded import CodedText, coded
from ...html.style import COLOURS, EDGES, HATCHES, INK, LIMIT, MARKERS, MUTED, POINTS, RULE, WIDTH, Drawing, style
from ...html.style import panels as laid_out
from ...limits import Limit
from ...order_statistics import quantiles


def theta_and_split(
    theta_deg: FloatArray,
    split_hz: FloatArray,
    verdicts: Sequence[str],
    theta_limit: Limit | None,
    split_limit: Limit | None,
    name: str = "theta-split",
) -> Drawing:
    """Left: theta as a rose of axes.  Middle: (split cos 2 theta, split sin 2 theta).  Right: histogram of split.

    Parameters
    ----------
    theta_deg, split_hz : (B,) estimates [deg], [Hz]; nan is not drawn.
    verdicts : B verdicts.
    theta_limit, split_limit : drawn where given.
    """
    known = np.isfinite(theta_deg) & np.isfinite(split_hz)
    theta, split, verdict = theta_deg[known], split_hz[known], coded(verdicts).at(known)
    with style():
        figure = Figure(figsize=(WIDTH, 3.6))
        rose = figure.add_axes((0.035, 0.15, 0.255, 0.68), projection="polar")
        assert isinstance(rose, PolarAxes)
        _rose(rose, theta, verdict, theta_limit)
        plane = figure.add_axes((0.4, 0.16, 0.245, 0.69))
        _plane(plane, theta, split, verdict, theta_limit, split_limit)
        axes = figure.add_axes((0.735, 0.16, 0.26, 0.69))
        _histogram(axes, split, verdict, split_limit)
        axes.set(xlabel="split, Hz", ylabel="devices")
        axes.set_title("Split")
        figure.legend(
            handles=_handles(),
            loc="lower left",
            ncols=1,
            bbox_to_anchor=(-0.012, -0.02),
            labelspacing=0.2,
            handletextpad=0.3,
            handlelength=1.2,
        )
        return Drawing(figure, name, "Distributions of theta and of the split, with limits, by verdict")


def histograms(
    panels: Sequence[tuple[str, FloatArray, Limit | None]], verdicts: Sequence[str], name: str = "histograms"
) -> Drawing:
    """A stacked histogram for each (label, (B,) values, limit), three in a row."""
    verdict = coded(verdicts)
    with style():
        down = -(-len(panels) // 3)
        figure, grid = laid_out(down, 3, 1.65, bottom=0.5, top=0.25, gap=0.5, between=0.75)
        for k, axes in enumerate(chain.from_iterable(grid)):
            if k >= len(panels):
                axes.set_axis_off()
                continue
            label, values, limit = panels[k]
            known = np.isfinite(values)
            _histogram(axes, values[known], verdict.at(known), limit)
            axes.set_xlabel(label)
            axes.set_ylabel("devices" if k % 3 == 0 else "")
        return Drawing(figure, name, "Distributions of the limited quantities, with limits, by verdict")


def _histogram(axes: Axes, values: FloatArray, verdict: CodedText, limit: Limit | None) -> None:
    if values.size:
        low, high = _window(values, limit)
        edges = np.linspace(low, high, int(np.clip(2.5 * values.size ** (1 / 3), 8, 40)) + 1)
        # Values beyond the window count in its last bars, so every device is shown.
        inside = np.clip(values, low, high)
        base = np.zeros(edges.size - 1)
        for kind in COLOURS:
            top = base + np.histogram(inside[verdict.equals(kind)], edges)[0]
            axes.stairs(top, edges, baseline=base, fill=True, fc=COLOURS[kind], ec="white", lw=0.4, hatch=HATCHES[kind])
            base = top
        axes.set_ylim(0, 1.08 * max(float(base.max()), 1.0))
        axes.set_xlim(low, high)
        beyond = int(np.sum((values < low) | (values > high)))
        if beyond:
            axes.set_title(f"{beyond} beyond the window, in its last bars", fontsize=9, weight="normal", color=MUTED)
    for end in (limit.low, limit.high) if limit else ():
        if np.isfinite(end):
            axes.axvline(end, color=LIMIT, lw=1.1, ls=(0, (4, 2)))
    axes.yaxis.set_major_locator(MaxNLocator(5, integer=True))


def _window(values: FloatArray, limit: Limit | None) -> tuple[float, float]:
    """The 1 to 99 % range, extended to nearby limits but not beyond the values."""
    q01, q99 = quantiles(values, (0.01, 0.99)).tolist()
    span = max(q99 - q01, 1e-9 * max(abs(q01), abs(q99), 1e-12))
    low, high = q01 - 0.1 * span, q99 + 0.1 * span
    for end in (limit.low, limit.high) if limit else ():
        if np.isfinite(end) and low - 0.6 * span < end < high + 0.6 * span:
            low, high = min(low, end - 0.06 * span), max(high, end + 0.06 * span)
    return float(low), float(high)


def _rose(axes: PolarAxes, theta: FloatArray, verdict: CodedText, limit: Limit | None) -> None:
    """Bars at theta and theta + 180 deg: an axis has both ends.  Areas, not radii, show the counts."""
    step = 10.0
    edges = np.arange(-90.0, 90.0 + step, step)
    base = np.zeros(edges.size - 1)
    for kind in COLOURS:
        count = np.histogram(theta[verdict.equals(kind)], edges)[0].astype(np.float64)
        inner, outer = np.sqrt(base), np.sqrt(base + count)
        for turn in (0.0, 180.0):
            axes.bar(
                np.radians(edges[:-1] + 0.5 * step + turn),
                outer - inner,
                bottom=inner,
                width=np.radians(step),
                color=COLOURS[kind],
                edgecolor="white",
                lw=0.3,
                hatch=HATCHES[kind],
            )
        base += count
    reach = 1.08 * float(np.sqrt(base.max())) if base.max() > 0 else 1.0
    if limit is not None:
        for end in (limit.low, limit.high):
            for turn in (0.0, 180.0):
                axes.plot(np.radians([end + turn] * 2), [0, reach], color=LIMIT, lw=1.1, ls=(0, (4, 2)))
    axes.set_ylim(0, reach)
    axes.set_yticks([])
    axes.set_xticks(np.radians(np.arange(0, 360, 45)), ["0°", "45°", "±90°", "−45°", "0°", "45°", "±90°", "−45°"])
    axes.tick_params(axis="x", pad=-2)
    axes.grid(color=RULE, lw=0.5)
    axes.spines["polar"].set_color(RULE)
    axes.set_title("Theta, as an axis", x=-0.1, y=1.13)


def _plane(
    axes: Axes,
    theta: FloatArray,
    split: FloatArray,
    verdict: CodedText,
    theta_limit: Limit | None,
    limit: Limit | None,
) -> None:
    """The anisotropy vector: independent spring errors scatter about a point in this plane."""
    step = max(1, -(-theta.size // POINTS))
    theta, split, verdict = theta[::step], split[::step], verdict[::step]
    reach = 1.1 * float(split.max()) if split.size else 1.0
    turn = np.linspace(0, 2 * np.pi, 181)
    if limit is not None:
        for end in (limit.low, limit.high):
            if np.isfinite(end) and end > 0:
                axes.plot(end * np.cos(turn), end * np.sin(turn), color=LIMIT, lw=1.1, ls=(0, (4, 2)))
                reach = max(reach, 1.1 * end) if end < 2 * reach else reach
    if theta_limit is not None:
        for end in (theta_limit.low, theta_limit.high):
            axes.plot(
                [0, 2 * reach * np.cos(2 * np.radians(end))],
                [0, 2 * reach * np.sin(2 * np.radians(end))],
                color=LIMIT,
                lw=1.1,
                ls=(0, (4, 2)),
            )
    x, y = split * np.cos(2 * np.radians(theta)), split * np.sin(2 * np.radians(theta))
    for kind in COLOURS:
        here = verdict.equals(kind)
        axes.plot(
            x[here],
            y[here],
            ls="none",
            marker=MARKERS[kind],
            ms=3.4,
            mfc=COLOURS[kind],
            mec=EDGES[kind],
            mew=0.3,
            alpha=0.85,
        )
    axes.axhline(0, color=RULE, lw=0.6, zorder=0)
    axes.axvline(0, color=RULE, lw=0.6, zorder=0)
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal")
    axes.set_xlabel("split · cos 2θ, Hz")
    axes.set_ylabel("split · sin 2θ, Hz", labelpad=1)
    axes.set_title("Anisotropy plane")


def _handles() -> list[Line2D]:
    verdicts = [
        Line2D([], [], ls="none", marker=MARKERS[kind], mfc=COLOURS[kind], mec=EDGES[kind], ms=5.5, label=kind)
        for kind in COLOURS
    ]
    return [*verdicts, Line2D([], [], color=INK, lw=1.1, ls=(0, (4, 2)), label="limit")]
