"""Where the loss comes from: shares of its variance by irregularity and level, the largest at the top (a tornado)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

from matplotlib.figure import Figure
from matplotlib.patches import Patch

from ...attribution.content import FIELD, PLACE
from ...html.style import INK, RULE, WIDTH, style, to_svg

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
    """A bar: name, level, and a share of one with its interval."""

    label: str
    level: str
    share: float
    low: float
    high: float


def tornado(bars: Sequence[SourceBar], xlabel: str, name: str = "tornado") -> str:
    """Horizontal bars with intervals, in the given order from the top."""
    with style():
        height = 0.34 * len(bars) + 0.95
        figure = Figure(figsize=(WIDTH, height))
        axes = figure.add_axes((0.3, 0.52 / height, 0.66, 0.34 * len(bars) / height))
        for k, bar in enumerate(bars):
            low, high = max(bar.low, 0.0), min(bar.high, 1.0)
            axes.barh(-k, 100.0 * max(bar.share, 0.0), height=0.66, color=LEVELS[bar.level][0])
            axes.plot([100.0 * low, 100.0 * high], [-k, -k], color=INK, lw=1.2, marker="|", ms=7, mew=1.2)
            text = f"{100.0 * bar.share:.1f} %"
            at = 100.0 * max(high, bar.share)
            axes.annotate(text, (at, -k), xytext=(6, 0), textcoords="offset points", va="center")
        axes.set_yticks([-k for k in range(len(bars))], [bar.label for bar in bars])
        axes.tick_params(axis="y", length=0)
        axes.set_ylim(-len(bars) + 0.5, 0.5)
        axes.set_xlim(0.0, 1.12 * max(100.0 * max(min(bar.high, 1.0), bar.share) for bar in bars))
        axes.set_xlabel(xlabel)
        axes.grid(axis="x", color=RULE, lw=0.6)
        axes.set_axisbelow(True)
        present = [level for level in LEVELS if any(bar.level == level for bar in bars)]
        handles = [Patch(color=LEVELS[level][0], label=LEVELS[level][2]) for level in present]
        figure.legend(
            handles=handles, loc="upper right", ncols=len(present), bbox_to_anchor=(0.97, 1.0), borderaxespad=0.1
        )
        return to_svg(figure, name, "Shares of the variance of the loss by irregularity and level")
