"""Causes of loss: the Pareto of failed limits, and fabrication against packaging."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from ...html.style import COLOURS, MUTED, RULE, WIDTH, Drawing, style


@dataclass(frozen=True)
class CauseBar:
    """Failed devices that break a limit, and those of them that break no other."""

    label: str
    failed: int
    alone: int


@dataclass(frozen=True)
class StageBar:
    """Truly lost devices of one limit, in fabrication and in packaging, and those that packaging recovered."""

    label: str
    fabrication: int
    packaging: int
    recovered: int


def pareto_bars(bars: Sequence[CauseBar], total: int, name: str = "pareto") -> Drawing:
    """Horizontal bars, most frequent first; the solid part breaks this limit only."""
    with style():
        height = 0.36 * len(bars) + 0.95
        figure = Figure(figsize=(WIDTH, height))
        axes = figure.add_axes((0.38, 0.52 / height, 0.58, 0.36 * len(bars) / height))
        for k, bar in enumerate(bars):
            axes.barh(-k, bar.alone, height=0.66, color=COLOURS["fail"], label="this limit alone" if k == 0 else None)
            axes.barh(
                -k,
                bar.failed - bar.alone,
                left=bar.alone,
                height=0.66,
                facecolor="#f7d9c4",
                edgecolor=COLOURS["fail"],
                hatch="////",
                lw=0.6,
                label="with others" if k == 0 else None,
            )
            share = 100 * bar.failed / max(total, 1)
            axes.annotate(
                f"{bar.failed}  ({share:.0f} %)",
                (bar.failed, -k),
                xytext=(5, 0),
                textcoords="offset points",
                va="center",
            )
        axes.set_yticks([-k for k in range(len(bars))], [bar.label for bar in bars])
        axes.tick_params(axis="y", length=0)
        axes.set_ylim(-len(bars) + 0.5, 0.5)
        axes.set_xlim(0, 1.18 * max([bar.failed for bar in bars] + [1]))
        axes.xaxis.set_major_locator(MaxNLocator(8, integer=True))
        axes.set_xlabel(f"devices, of {total} failed (a device may break several limits)")
        axes.grid(axis="x", color=RULE, lw=0.6)
        axes.set_axisbelow(True)
        figure.legend(loc="upper right", ncols=2, bbox_to_anchor=(0.97, 1.0), borderaxespad=0.1)
        return Drawing(figure, name, "Failed devices by limit")


def stage_bars(bars: Sequence[StageBar], name: str = "stages") -> Drawing:
    """To the right, devices lost in fabrication and in packaging; to the left, those that packaging recovered."""
    with style():
        height = 0.36 * len(bars) + 0.95
        figure = Figure(figsize=(WIDTH, height))
        axes = figure.add_axes((0.38, 0.52 / height, 0.58, 0.36 * len(bars) / height))
        bar_styles = (
            ("lost in fabrication", "fabrication", "#6b4c9a", "", 1),
            ("lost in packaging", "packaging", "#e0a040", "////", 1),
            ("recovered by packaging", "recovered", "#4d9a6f", "..", -1),
        )
        counts = {key: np.array([getattr(bar, key) for bar in bars]) for _, key, *_ in bar_styles}
        y = -np.arange(len(bars))
        for label, key, colour, hatch, sign in bar_styles:
            left = counts["fabrication"] if key == "packaging" else np.zeros(len(bars), dtype=np.int64)
            axes.barh(
                y,
                sign * counts[key],
                left=left,
                height=0.66,
                color=colour,
                edgecolor="white",
                hatch=hatch,
                lw=0.5,
                label=label,
            )
        for k, bar in enumerate(bars):
            text = f"{bar.fabrication} + {bar.packaging}"
            axes.annotate(
                text, (bar.fabrication + bar.packaging, -k), xytext=(5, 0), textcoords="offset points", va="center"
            )
        axes.axvline(0.0, color=MUTED, lw=0.8)
        axes.set_yticks(y, [bar.label for bar in bars])
        axes.tick_params(axis="y", length=0)
        axes.set_ylim(-len(bars) + 0.5, 0.5)
        most = max([bar.fabrication + bar.packaging for bar in bars] + [1])
        axes.set_xlim(-1.15 * max([bar.recovered for bar in bars] + [0]), 1.18 * most)
        axes.xaxis.set_major_locator(MaxNLocator(8, integer=True))
        axes.xaxis.set_major_formatter(lambda value, _: f"{abs(value):.0f}")
        axes.set_xlabel("devices whose truth is outside the limit")
        axes.grid(axis="x", color=RULE, lw=0.6)
        axes.set_axisbelow(True)
        figure.legend(loc="upper right", ncols=3, bbox_to_anchor=(0.97, 1.0), borderaxespad=0.1)
        return Drawing(figure, name, "Devices lost in fabrication and in packaging, by limit")
