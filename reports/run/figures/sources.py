"""Where the loss comes from: shares of its variance by irregularity and level, the largest at the top (a tornado)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from ...attribution.content import FIELD, PLACE
from ...html.style import INK, MUTED, RULE, WIDTH, Drawing, literal, style

#: Okabe and Ito 2008; each bar also has its level in its name.
LEVELS: Mapping[str, tuple[str, str, str]] = MappingProxyType(
    {
        "lot": ("#0072b2", "", "lot"),
        "wafer": ("#56b4e9", "", "wafer"),
        FIELD: ("#009e73", "", "within the wafer"),
        "die": ("#e69f00", "", "die"),
        "package": ("#cc79a7", "", "package"),
        PLACE: ("#b0b7bf", "", "place of the die"),
    }
)


@dataclass(frozen=True)
class SourceBar:
    """A bar: name, level, a share of one with its interval, and the same of the change if it were halved (``None``: unknown)."""

    label: str
    level: str
    share: tuple[float, float, float]
    halved: tuple[float, float, float] | None


def tornado(bars: Sequence[SourceBar], name: str = "tornado") -> Drawing:
    """Horizontal bars with intervals, in the given order from the top: shares, and beside them what halving would change."""
    with style():
        height = 0.34 * len(bars) + 0.95
        figure = Figure(figsize=(WIDTH, height))
        bottom, tall = 0.52 / height, 0.34 * len(bars) / height
        left, right = figure.add_axes((0.25, bottom, 0.41, tall)), figure.add_axes((0.7, bottom, 0.27, tall))
        for k, bar in enumerate(bars):
            value, low, high = (100.0 * end for end in bar.share)
            _bar(left, k, max(value, 0.0), max(low, 0.0), min(high, 100.0), bar.level)
            left.annotate(
                f"{value:.1f} %",
                (max(min(high, 100.0), value), -k),
                xytext=(6, 0),
                textcoords="offset points",
                va="center",
            )
            if bar.halved is not None:
                change, below, above = (100.0 * end for end in bar.halved)
                _bar(right, k, change, below, above, bar.level)
        left.set_yticks([-k for k in range(len(bars))], [literal(bar.label) for bar in bars])
        right.set_yticks([])
        left.set_xlim(0.0, 1.2 * max(100.0 * max(min(bar.share[2], 1.0), bar.share[0]) for bar in bars))
        left.set_xlabel("share of the variance of the true loss, %")
        right.set_xlabel("change of the loss if halved, points")
        right.axvline(0.0, color=INK, lw=0.8)
        right.spines["left"].set_visible(False)
        for axes in (left, right):
            axes.tick_params(axis="y", length=0)
            axes.set_ylim(-len(bars) + 0.5, 0.5)
            axes.grid(axis="x", color=RULE, lw=0.6)
            axes.set_axisbelow(True)
        present = [level for level in LEVELS if any(bar.level == level for bar in bars)]
        handles = [Patch(color=LEVELS[level][0], label=LEVELS[level][2]) for level in present]
        figure.legend(
            handles=handles, loc="upper right", ncols=len(present), bbox_to_anchor=(0.97, 1.0), borderaxespad=0.1
        )
        return Drawing(
            figure, name, "Shares of the variance of the loss by irregularity and level, and what halving would change"
        )


def _bar(axes: Axes, k: int, value: float, low: float, high: float, level: str) -> None:
    # An irregularity of the user may have another level.
    axes.barh(-k, value, height=0.66, color=LEVELS.get(level, (MUTED,))[0])
    axes.plot([low, high], [-k, -k], color=INK, lw=1.2, marker="|", ms=7, mew=1.2)
