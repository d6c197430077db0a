"""Figures of a lot: forecast yields, spreads against the file, wafer maps of the residual."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle
from matplotlib.ticker import MaxNLocator

from pipeline.arrays import ComplexArray, FloatArray
from pipeline.learning.lot.answers import LotRungAnswer, SpreadAnswer

from ..html.style import ACCENT, AFTER, BEFORE, INK, MUTED, RULE, Drawing, panels, style

#: Maps in a row, and quantities that get a map.
ACROSS, MOST = 4, 8
#: Colour scale of a mean residual [sd of the mean].
SCALE = 4.0


@dataclass(frozen=True, eq=False)
class LotMaps:
    """Left-out residuals z (n, q) [sd] of the devices at ``x_mm``, ``y_mm`` (n,) [mm] on ``wafers``."""

    x_mm: FloatArray
    y_mm: FloatArray
    wafers: Sequence[str]
    quantities: tuple[str, ...]
    z: FloatArray


def forecast_figure(ladder: Sequence[LotRungAnswer], name: str = "forecast") -> Drawing | None:
    """Forecast yield with its 90 % interval and log score of the held-out wafers, rung by rung; ``None`` without forecasts."""
    rungs = [rung for rung in ladder if rung.forecast is not None]
    if not rungs:
        return None
    at = np.arange(len(rungs))[::-1]
    with style():
        figure, ((left, right),) = panels(1, 2, 0.45 * len(rungs) + 0.5, left=2.6, right=0.2, bottom=0.6, gap=0.7)
        for place, rung in zip(at, rungs):
            found = rung.forecast
            assert found is not None
            colour = AFTER if found.inside else BEFORE
            left.plot(
                [100 * found.low, 100 * found.high],
                [place, place],
                color=colour,
                lw=5,
                solid_capstyle="butt",
                alpha=0.45,
            )
            left.plot([100 * found.mean], [place], "o" if found.inside else "X", color=colour, ms=7)
        measured = rungs[-1].forecast
        assert measured is not None
        left.axvline(100 * measured.measured, color=INK, lw=1.2, ls="--")
        left.set_title("Yield of the held-out wafers")
        left.set_xlabel(f"%, forecast with its 90 % interval; dashed: measured, {100 * measured.measured:.1f} %")
        left.set_yticks(at, [_short(rung.model) for rung in rungs])
        left.set_xlim(0, 100)
        scores = np.array([np.nan if rung.log_score_validate is None else rung.log_score_validate for rung in rungs])
        right.plot(scores - np.nanmax(scores), at, "o-", color=ACCENT)
        right.set_title("Log score of the held-out wafers")
        right.set_xlabel("below the best, nats a device")
        right.set_yticks(at, [])
        right.xaxis.set_major_locator(MaxNLocator(4))
        for axes in (left, right):
            axes.grid(axis="x", color=RULE, lw=0.6)
            axes.set_ylim(-0.6, len(rungs) - 0.4)
        return Drawing(
            figure, name, "Forecast and measured yield, and held-out log score, for each model of the ladder"
        )


def spreads_figure(spreads: Mapping[str, SpreadAnswer], name: str = "spreads") -> Drawing | None:
    """Fitted spread over that of the file, with 90 % intervals, on a logarithmic axis; empty where there is none."""
    if not spreads:
        return None
    low_end, high_end = 0.1, 10.0
    at = np.arange(len(spreads))[::-1]
    with style():
        figure, ((axes,),) = panels(1, 1, 0.24 * len(spreads) + 0.3, left=2.6, bottom=0.6)
        axes.axvline(1.0, color=INK, lw=0.8)
        for place, one in zip(at, spreads.values()):
            colour = AFTER if one.agrees else BEFORE
            ends = np.clip([one.low, one.high], low_end, high_end)
            axes.plot(ends, [place, place], color=colour, lw=1.8)
            marker = "o" if low_end < one.ratio < high_end else "<" if one.ratio <= low_end else ">"
            axes.plot(
                [np.clip(one.ratio, low_end, high_end)], [place], marker if one.agrees else "X", color=colour, ms=6
            )
        axes.set_xscale("log")
        axes.set_xlim(low_end, high_end)
        axes.set_xticks([0.1, 0.2, 0.5, 1, 2, 5, 10], ["≤ 0.1", "0.2", "0.5", "1", "2", "5", "≥ 10"])
        axes.minorticks_off()
        axes.set_yticks(at, list(spreads))
        axes.set_ylim(-0.7, len(spreads) - 0.3)
        axes.grid(axis="x", color=RULE, lw=0.6)
        axes.set_xlabel("fitted spread / spread of the file; bar: 90 % interval; cross: leaves out 1")
        return Drawing(figure, name, "Fitted spreads relative to the population file")


def residual_maps(maps: LotMaps, name: str, like: LotMaps | None = None) -> Drawing | None:
    """Mean residual of all wafers at each place, in sds of the mean, of the quantities with most structure in ``like``."""
    known = np.isfinite(maps.x_mm) & np.isfinite(maps.y_mm)
    if not np.any(known):
        return None
    places, count, score = stacked_means(maps)
    order = np.argsort(-np.mean(stacked_means(like or maps)[2] ** 2, axis=0))[:MOST]
    radius = 1.08 * float(np.abs(places).max()) or 1.0
    across = min(ACROSS, len(order))
    down = -(-len(order) // across)
    with style():
        figure, grid = panels(down, across, 2.35, left=0.1, right=1.0, bottom=0.25, top=0.35, gap=0.1)
        marks = None
        for k, axes in enumerate(chain.from_iterable(grid)):
            axes.set_axis_off()
            if k >= len(order):
                continue
            _outline(axes, radius)
            own = count[:, order[k]] > 0
            marks = axes.scatter(
                places.real[own],
                places.imag[own],
                c=score[own, order[k]],
                cmap=matplotlib.colormaps["PuOr_r"],
                vmin=-SCALE,
                vmax=SCALE,
                marker="s",
                s=_marker(places, radius),
                linewidths=0,
            )
            rms = float(np.sqrt(np.mean(score[own, order[k]] ** 2)))
            axes.set_title(f"{maps.quantities[order[k]]}: {rms:.2f}", fontsize=9.0)
        if marks is not None:
            bar = figure.colorbar(marks, cax=figure.add_axes((0.925, 0.2, 0.014, 0.6)))
            bar.set_label("mean residual, sd of the mean")
        return Drawing(figure, name, "Mean residual of all wafers at each place, by quantity")


def stacked_means(maps: LotMaps) -> tuple[ComplexArray, FloatArray, FloatArray]:
    """Places (P,) x + i y [mm], number of residuals and mean residual [sd of the mean] of each quantity (P, q)."""
    known = np.isfinite(maps.x_mm) & np.isfinite(maps.y_mm)
    x, y, z = maps.x_mm[known], maps.y_mm[known], maps.z[known]
    places, index = np.unique(np.round(x, 3) + 1j * np.round(y, 3), return_inverse=True)

    def summed(values: FloatArray) -> FloatArray:
        return np.stack([np.bincount(index, weights=row, minlength=len(places)) for row in values.T], axis=1)

    count = summed(np.isfinite(z).astype(np.float64))
    return places, count, summed(np.nan_to_num(z)) / np.sqrt(np.maximum(count, 1.0))


def _marker(at: ComplexArray, radius: float) -> float:
    steps = np.concatenate([np.diff(np.unique(np.round(at.real, 3))), np.diff(np.unique(np.round(at.imag, 3)))])
    pitch = float(np.median(steps)) if steps.size else radius / 4.0
    return float(np.clip(0.9 * pitch / (2.1 * radius) * 72 * 2.3, 2.0, 14.0)) ** 2


def _outline(axes: Axes, radius: float) -> None:
    axes.add_patch(Circle((0, 0), radius, fc="#f7f8f9", ec=MUTED, lw=0.8, zorder=0))
    axes.set(xlim=(-1.03 * radius, 1.03 * radius), ylim=(-1.03 * radius, 1.03 * radius), aspect="equal")


def _short(text: str) -> str:
    return text if len(text) <= 34 else text[:33] + "…"
