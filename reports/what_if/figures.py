"""The figures of a what-if page; ``None`` if there is nothing to draw."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from ..html.style import ACCENT, BEFORE, INK, MUTED, RULE, Drawing, literal, panels, style
from ..words.quantities import UNITS, label
from .costs import LimitCurve, PairLoss

_COLUMNS = 3
#: Pairs that are drawn: those below them cost less.
MOST_PAIRS = 8


def curve_panels(curves: Sequence[LimitCurve], name: str = "limit-curves") -> Drawing | None:
    """The yield against each end of each limit, with its 95 % band; the old and the new end as lines."""
    if not curves:
        return None
    with style():
        rows = -(-len(curves) // _COLUMNS)
        figure, grid = panels(rows, _COLUMNS, 1.75, left=0.62, between=0.82, bottom=0.62, gap=0.3, sharey=True)
        cells = [axes for row in grid for axes in row]
        top = 100.0 * max(float(curve.high_share.max()) for curve in curves)
        for axes, curve in zip(cells, curves, strict=False):
            _curve(axes, curve, min(104.0, 1.05 * top))
        for axes in cells[len(curves) :]:
            axes.set_visible(False)
        for row in grid:
            row[0].set_ylabel("yield, %")
        return Drawing(figure, name, "Yield against the position of each limit, the others held")


def _curve(axes: Axes, curve: LimitCurve, top: float) -> None:
    axes.fill_between(curve.positions, 100 * curve.low, 100 * curve.high_share, color=ACCENT, alpha=0.18, lw=0)
    axes.plot(curve.positions, 100 * curve.share, color=ACCENT, lw=1.6)
    if curve.old != curve.new:
        axes.axvline(curve.old, color=BEFORE, lw=1.3, ls=(0, (4, 2)))
    axes.axvline(curve.new, color=INK, lw=1.1)
    axes.plot([curve.new], [100 * curve.yield_new], "o", color=INK, ms=4.5)
    unit = UNITS.get(curve.limit.quantity, "")
    axes.set_title(f"{label(curve.limit.quantity)}, {'upper' if curve.high else 'lower'} limit", fontsize=10)
    axes.set_xlabel(literal(unit), labelpad=1)
    axes.set_xlim(float(curve.positions[0]), float(curve.positions[-1]))
    axes.set_ylim(0.0, top)
    axes.xaxis.set_major_locator(MaxNLocator(4))
    axes.grid(color=RULE, lw=0.5)
    axes.set_axisbelow(True)


def pair_bars(pairs: Sequence[PairLoss], devices: int, name: str = "limit-pairs") -> Drawing | None:
    """The devices lost to the costliest pairs of limits: to one alone, to the other alone, and to both together."""
    shown = [pair for pair in pairs if pair.devices > 0][:MOST_PAIRS]
    if not shown:
        return None
    with style():
        figure, grid = panels(1, 1, 0.36 * len(shown) + 0.15, left=3.7, bottom=0.55, top=0.4, right=0.6)
        axes = grid[0][0]
        scale = 100.0 / devices
        for k, pair in enumerate(shown):
            start = 0.0
            parts = (
                (pair.first_alone, ACCENT, "", "first alone"),
                (pair.second_alone, "#56b4e9", "", "second alone"),
                (pair.both, BEFORE, "////", "only with both"),
            )
            for count, colour, hatch, text in parts:
                axes.barh(
                    -k, scale * count, left=start, height=0.62, color=colour, hatch=hatch, edgecolor="white", lw=0.6,
                    label=text if k == 0 else None,
                )  # fmt: skip
                start += scale * count
            low, high = scale * devices * pair.share.low, scale * devices * pair.share.high
            axes.plot([low, high], [-k, -k], color=INK, lw=1.0)
            axes.annotate(
                f"{start:.1f} %", (max(start, high), -k), (6, 0), textcoords="offset points", va="center", fontsize=10,
                color=MUTED,
            )  # fmt: skip
        axes.set_yticks(
            [-k for k in range(len(shown))],
            [f"{label(one.first.quantity)}  and  {label(one.second.quantity)}" for one in shown],
        )
        axes.set_ylim(-len(shown) + 0.4, 0.6)
        # Room for the last label.
        axes.set_xlim(0.0, 1.12 * max(scale * max(devices * pair.share.high, pair.devices) for pair in shown))
        axes.tick_params(axis="y", length=0)
        axes.grid(axis="x", color=RULE, lw=0.5)
        axes.set_axisbelow(True)
        axes.set_xlabel("devices that pass without the pair, % of all")
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 0.995), ncols=3, handlelength=1.2, borderaxespad=0.1)
        return Drawing(figure, name, "Loss to the costliest pairs of limits")
