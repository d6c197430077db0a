"""Wafer maps: verdicts at the die positions, and the yield by position over all wafers."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle

from pipeline.arrays import BoolArray, FloatArray

from ...coded import IntArray, coded, numbered
from ...html.style import COLOURS, EDGES, MARKERS, MUTED, RULE, WIDTH, Drawing, style
from ...html.style import panels as laid_out
from ...yields import natural

COLUMNS = 4
# More positions than this cannot be told apart on the map: their markers would be smaller than a point.
PLACES = 10_000
MOST = 12


def wafer_maps(
    x_mm: FloatArray,
    y_mm: FloatArray,
    verdicts: Sequence[str],
    wafers: Sequence[str],
    name: str = "wafer-maps",
    most: int = MOST,
) -> Drawing:
    """One small map per wafer in order of name, at most ``most``.

    Parameters
    ----------
    x_mm, y_mm : (B,) die centres from the wafer centre [mm]; nan is not drawn.
    verdicts, wafers : B each.
    """
    verdict, wafer = coded(verdicts), coded(wafers)
    names = sorted(wafer.counts(), key=natural)[:most]
    radius = _radius(x_mm, y_mm)
    with style():
        across = min(COLUMNS, max(2, len(names)))
        down = -(-len(names) // across)
        height = 2.45 if across == COLUMNS else 2.7
        figure, grid = laid_out(down, across, height, left=0.1, bottom=0.4, top=0.3, gap=0.1)
        for k, axes in enumerate(chain.from_iterable(grid)):
            if k >= len(names):
                axes.set_axis_off()
                continue
            here = np.flatnonzero(wafer.equals(names[k]) & np.isfinite(x_mm) & np.isfinite(y_mm))
            own = verdict.at(here)
            passed, n = int(np.sum(own.equals("pass"))), here.size
            _outline(axes, radius)
            size = _marker_size(x_mm[here], y_mm[here], radius, across)
            for kind in COLOURS:
                chosen = here[own.equals(kind)]
                axes.plot(
                    x_mm[chosen],
                    y_mm[chosen],
                    ls="none",
                    marker=MARKERS[kind],
                    ms=size * (0.8 if kind == "undecided" else 1.0),
                    mfc=COLOURS[kind],
                    mec=EDGES[kind],
                    mew=0.6,
                )
            axes.set_title(f"{names[k]}: {passed} of {n} pass", fontsize=10)
        figure.legend(handles=_handles(), loc="lower left", ncols=3, handletextpad=0.3)
        return Drawing(figure, name, "Verdicts at the die positions of each wafer")


def stacked_map(x_mm: FloatArray, y_mm: FloatArray, passed: BoolArray, name: str = "stacked-map") -> Drawing:
    """All wafers on one: the share of devices that pass at each die position, and against the radius.

    Parameters
    ----------
    x_mm, y_mm : (B,) die centres [mm]; nan is not drawn.
    passed : (B,) whether the device passes.
    """
    known = np.isfinite(x_mm) & np.isfinite(y_mm)
    radius = _radius(x_mm, y_mm)
    places, index = _places(x_mm[known], y_mm[known], radius)
    n = np.bincount(index, minlength=len(places))
    share = np.bincount(index, weights=passed[known].astype(np.float64), minlength=len(places)) / np.maximum(n, 1)
    with style():
        figure = Figure(figsize=(WIDTH, 3.7))
        left, right = (figure.add_axes(place) for place in ((0.01, 0.04, 0.38, 0.87), (0.55, 0.15, 0.44, 0.76)))
        _outline(left, radius)
        size = _marker_size(places[:, 0], places[:, 1], radius, 2) ** 2
        marks = left.scatter(
            places[:, 0],
            places[:, 1],
            c=100 * share,
            cmap=matplotlib.colormaps["cividis"].resampled(10),
            vmin=0,
            vmax=100,
            marker="s",
            s=size,
            linewidths=0,
        )
        bar = figure.colorbar(marks, cax=figure.add_axes((0.405, 0.12, 0.018, 0.7)))
        bar.set_label("pass, %")
        each = f"{n.min()}" if n.min() == n.max() else f"{n.min()} to {n.max()}"
        left.set_title(f"All wafers on one ({each} devices a die)")
        _by_radius(right, np.hypot(x_mm[known], y_mm[known]), passed[known], radius)
        return Drawing(figure, name, "Share of passing devices by die position and by radius")


def _places(x_mm: FloatArray, y_mm: FloatArray, radius: float) -> tuple[FloatArray, IntArray]:
    """Different die positions (P, 2) [mm] and the number (B,) of each die's position; on a grid if P exceeds ``PLACES``."""
    for pitch in (1e-3, 2.0 * radius / PLACES**0.5):
        (columns, column), (rows, row) = (_steps(np.asarray(np.rint(at / pitch))) for at in (x_mm, y_mm))
        present, index = numbered(column * rows.size + row)
        if present.size <= PLACES:
            break
    return pitch * np.stack([columns[present // rows.size], rows[present % rows.size]], axis=1), index


def _steps(whole: FloatArray) -> tuple[FloatArray, IntArray]:
    """The different whole numbers (S,) and the place (B,) of each of ``whole`` in them."""
    least = whole.min()
    if whole.max() - least > 8.0 * whole.size:  # positions on no grid: sorting them takes no array of all steps
        different, place = np.unique(whole, return_inverse=True)
        return different, place.astype(np.int64)
    present, index = numbered((whole - least).astype(np.int64))
    return least + present, index


def _by_radius(axes: Axes, r_mm: FloatArray, passed: BoolArray, radius: float) -> None:
    # Rings of equal area hold about equal numbers of dies.
    edges = radius * np.sqrt(np.linspace(0.0, 1.0, 6))
    ring = np.clip(np.searchsorted(edges, r_mm, side="right") - 1, 0, 4)
    for k in range(5):
        here = passed[ring == k]
        if here.size == 0:
            continue
        share = float(here.mean())
        sd = np.sqrt(max(share * (1 - share), 0.25 / (here.size + 4)) / here.size)
        middle = 0.5 * (edges[k] + edges[k + 1])
        low, high = max(0.0, share - 1.96 * sd), min(1.0, share + 1.96 * sd)
        axes.plot([middle, middle], [100 * low, 100 * high], color=COLOURS["pass"], lw=1.2)
        axes.plot([middle], [100 * share], "o", color=COLOURS["pass"], ms=5)
        axes.annotate(
            f"{here.size}", (middle, 100 * share), xytext=(6, 4), textcoords="offset points", fontsize=9.5, color=MUTED
        )
    axes.set(xlim=(0, radius), ylim=(0, 100), xlabel="distance from the wafer centre, mm", ylabel="pass, %")
    axes.set_title("Yield by ring of equal area, 95 % intervals")
    axes.grid(axis="y", color=RULE, lw=0.6)


def _radius(x_mm: FloatArray, y_mm: FloatArray) -> float:
    r = np.hypot(x_mm, y_mm)
    r = r[np.isfinite(r)]
    return 1.12 * float(r.max()) if r.size and r.max() > 0 else 1.0


def _marker_size(x_mm: FloatArray, y_mm: FloatArray, radius: float, across: int) -> float:
    """Marker size in points that fills most of a die pitch."""
    steps = np.concatenate([np.diff(np.unique(np.round(x_mm, 3))), np.diff(np.unique(np.round(y_mm, 3)))])
    pitch = float(np.median(steps)) if steps.size else radius / 4
    return float(np.clip(0.75 * pitch / (2.2 * radius) * 72 * (8.6 / across), 2.2, 13.0))


def _outline(axes: Axes, radius: float) -> None:
    axes.add_patch(Circle((0, 0), radius, fc="#f7f8f9", ec=MUTED, lw=0.8, zorder=0))
    axes.set(xlim=(-1.05 * radius, 1.05 * radius), ylim=(-1.05 * radius, 1.05 * radius), aspect="equal")
    axes.set_axis_off()


def _handles() -> list[Line2D]:
    return [
        Line2D([], [], ls="none", marker=MARKERS[kind], mfc=COLOURS[kind], mec=EDGES[kind], ms=6, label=kind)
        for kind in COLOURS
    ]
