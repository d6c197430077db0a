"""Calibration against the virtual truth: coverage with its binomial band, z-scores."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from scipy.special import ndtri

from pipeline.arrays import FloatArray

from ...html.style import ACCENT, COLOURS, INK, MUTED, POINTS, RULE, WIDTH, Drawing, style
from ...html.style import panels as laid_out
from ..calibration import NOMINAL, Coverage


def coverage_dots(rows: Sequence[tuple[str, Coverage]], name: str = "coverage") -> Drawing:
    """Coverage of the 90 % intervals of each (label, coverage), with the 95 % binomial band."""
    with style():
        height = 0.26 * len(rows) + 0.8
        figure = Figure(figsize=(WIDTH, height))
        # Room for the longest name, "dependence of the scale factor on the split", in the font of the labels.
        axes = figure.add_axes((0.31, 0.5 / height, 0.61, (height - 0.8) / height))
        for k, (_, row) in enumerate(rows):
            axes.fill_betweenx([-k - 0.5, -k + 0.5], 100 * row.band[0], 100 * row.band[1], color="#e3edf4", lw=0)
            colour = ACCENT if row.in_band else COLOURS["fail"]
            axes.plot([100 * row.interval.low, 100 * row.interval.high], [-k, -k], color=colour, lw=1.3)
            axes.plot([100 * row.share], [-k], marker="o" if row.in_band else "X", color=colour, ms=5.5)
            axes.text(
                1.015, -k, f"{100 * row.share:.1f}", transform=axes.get_yaxis_transform(), va="center", color=MUTED
            )
        axes.axvline(100 * NOMINAL, color=INK, lw=0.9)
        axes.set_yticks([-k for k in range(len(rows))], [label for label, _ in rows])
        axes.tick_params(axis="y", length=0)
        axes.set_ylim(-len(rows) + 0.5, 0.5)
        axes.set_xlim(min([100 * row.interval.low for _, row in rows] + [80.0]) - 1.0, 100.5)
        axes.set_xlabel("truth inside the 90 % interval, % of devices (band: chance; bars: 95 % intervals)")
        return Drawing(figure, name, "Coverage of the 90 % intervals by quantity")


def z_panels(panels: Sequence[tuple[str, FloatArray]], name: str = "z-scores") -> Drawing:
    """For each (label, z (n,)): histogram over the standard normal, and normal quantile plot."""
    with style():
        figure, rows = laid_out(1, 2 * len(panels), 2.25, left=0.6, bottom=0.5, top=0.15, gap=0.55)
        axes = rows[0]
        grid = np.linspace(-4, 4, 121)
        for k, (label, z) in enumerate(panels):
            histogram, quantile = axes[2 * k], axes[2 * k + 1]
            histogram.hist(
                np.clip(z, -4, 4), bins=list(np.linspace(-4, 4, 25)), density=True, color="#9cc4de", ec="white", lw=0.4
            )
            histogram.plot(grid, np.exp(-0.5 * grid**2) / np.sqrt(2.0 * np.pi), color=INK, lw=1.1)
            histogram.set(xlabel=f"z of {label}", xlim=(-4, 4), ylabel="density" if k == 0 else "")
            ordered = np.sort(z)
            expected = ndtri((np.arange(z.size) + 0.5) / max(z.size, 1))
            step = max(1, -(-z.size // POINTS))
            quantile.plot(expected[::step], np.clip(ordered[::step], -6, 6), "o", ms=2.4, color=ACCENT, mew=0)
            quantile.plot([-4, 4], [-4, 4], color=INK, lw=0.9)
            quantile.set(xlabel="normal quantile", ylabel=f"z of {label}", xlim=(-4, 4), ylim=(-6.2, 6.2))
            quantile.grid(color=RULE, lw=0.5)
        return Drawing(figure, name, "z-scores against the standard normal")
