"""Cpk and Ppk of the limited quantities."""

from __future__ import annotations

import math
from collections.abc import Sequence

from matplotlib.axes import Axes

from ...capability import Capability, Index
from ...html.style import ACCENT, BEFORE, INK, MUTED, RULE, Drawing, panels, style
from ...words.quantities import label, limit_words

#: 1.33: the usual demand on a process (AIAG, PPAP manual: 1.33 acceptable with approval, 1.67 without).
_DEMAND = 1.33


def capability_bars(rows: Sequence[Capability], name: str = "capability") -> Drawing | None:
    """Cpk (within wafers) and Ppk (over all) of each quantity with 95 % intervals; ``None`` without any."""
    shown = [row for row in rows if row.cpk is not None and row.ppk is not None]
    if not shown:
        return None
    with style():
        figure, grid = panels(1, 1, 0.5 * len(shown) + 0.1, left=3.9, bottom=0.55, top=0.42, right=0.25)
        axes = grid[0][0]
        ends = [end for row in shown for one in (row.cpk, row.ppk) if one is not None for end in (one.low, one.high)]
        finite = [end for end in ends if math.isfinite(end)]
        left, right = min([0.0, *finite]), min(5.0, max([1.5, *finite]))
        left = max(left, -3.0)
        for k, row in enumerate(shown):
            for offset, one, colour, marker, text in (
                (0.13, row.cpk, ACCENT, "o", "Cpk, within wafers"),
                (-0.13, row.ppk, BEFORE, "s", "Ppk, over all"),
            ):
                if one is None:
                    continue
                _interval(axes, -k + offset, one, (left, right), colour, marker, text if k == 0 else None)
        axes.axvline(1.0, color=INK, lw=0.9)
        axes.axvline(_DEMAND, color=MUTED, lw=0.9, ls=(0, (4, 2)))
        axes.set_yticks(
            [-k for k in range(len(shown))],
            [f"{label(row.limit.quantity)} {limit_words(row.limit)}" for row in shown],
        )
        axes.set_ylim(-len(shown) + 0.45, 0.55)
        axes.set_xlim(left, right)
        axes.tick_params(axis="y", length=0)
        axes.grid(axis="x", color=RULE, lw=0.5)
        axes.set_axisbelow(True)
        axes.set_xlabel("index; lines: 1 and 1.33")
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 0.99), ncols=2, handlelength=1.2, borderaxespad=0.1)
        return Drawing(figure, name, "Capability of each limited quantity with its 95 % interval")


def _interval(
    axes: Axes, y: float, one: Index, window: tuple[float, float], colour: str, marker: str, text: str | None
) -> None:
    low, high = (min(max(end, window[0]), window[1]) for end in (one.low, one.high))
    axes.plot([low, high], [y, y], color=colour, lw=2.6, alpha=0.55, solid_capstyle="butt")
    value = min(max(one.value, window[0]), window[1])
    axes.plot([value], [y], marker, color=colour, ms=5.5, label=text, clip_on=False)
