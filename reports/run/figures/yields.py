"""The uncertainties of the yield on one scale."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from matplotlib.figure import Figure

from ...html.style import ACCENT, MUTED, RULE, WIDTH, Drawing, style


@dataclass(frozen=True)
class Span:
    """low <= value <= high (shares), from one source; ``question`` is the heading of its group."""

    question: str
    label: str
    low: float
    value: float
    high: float


def yield_spans(spans: Sequence[Span], name: str = "yield-spans") -> Drawing:
    """Each span as a bar with its value, grouped by the question that it answers."""
    with style():
        rows: list[tuple[str, Span | None]] = []
        for span in spans:
            if not any(one is not None and one.question == span.question for _, one in rows):
                rows.append((span.question, None))
            rows.append((span.label, span))
        figure = Figure(figsize=(WIDTH, 0.3 * len(rows) + 0.65))
        axes = figure.add_axes((0.36, 0.5 / (0.3 * len(rows) + 0.65), 0.53, 0.3 * len(rows) / (0.3 * len(rows) + 0.65)))
        low = min((span.low for span in spans), default=0.0)
        high = max((span.high for span in spans), default=1.0)
        room = max(0.02, 0.08 * (high - low))
        left, right = 100 * max(0.0, low - room), 100 * min(1.0, high + room)
        for k, (label, one) in enumerate(rows):
            y = -float(k)
            if one is None:
                axes.text(
                    -0.675, y, label, transform=axes.get_yaxis_transform(), va="center", weight="bold", fontsize=10.5
                )
                continue
            axes.plot([100 * one.low, 100 * one.high], [y, y], color=ACCENT, lw=4, solid_capstyle="butt", alpha=0.55)
            axes.plot([100 * one.value], [y], marker="|", ms=11, mew=2, color="#003c5f")
            axes.text(-0.64, y, label, transform=axes.get_yaxis_transform(), va="center", fontsize=10.5)
            axes.text(
                1.02,
                y,
                f"{100 * one.low:.1f} to {100 * one.high:.1f}",
                transform=axes.get_yaxis_transform(),
                va="center",
                fontsize=10,
                color=MUTED,
            )
        axes.set_ylim(-len(rows) + 0.4, 0.6)
        axes.set_xlim(left, right)
        axes.set_yticks([])
        axes.spines["left"].set_visible(False)
        axes.grid(axis="x", color=RULE, lw=0.6)
        axes.set_axisbelow(True)
        axes.set_xlabel("yield, %")
        return Drawing(figure, name, "Intervals of the yield by source of uncertainty")
