"""Yield and risks against the guard band."""

from __future__ import annotations

import numpy as np

from ...decision_risk import RiskCurve
from ...html.style import ACCENT, BEFORE, INK, RULE, Drawing, log_ticks, panels, style
from ...rules import Rule


def risk_curve_figure(curve: RiskCurve, rule: Rule, name: str = "risk-curve") -> Drawing:
    """Accepted share, and consumer's and producer's risk, against the factor k of a guard band of k u; the truth dashed."""
    with style():
        figure, grid = panels(1, 2, 2.2, left=0.75, bottom=0.6, gap=0.8, top=0.4)
        left, right = grid[0]
        left.plot(curve.k, 100 * curve.accepted, color=ACCENT, lw=1.6)
        left.set_ylabel("accepted, %")
        lines = [
            ("consumer's", curve.consumer, curve.true_consumer, BEFORE),
            ("producer's", curve.producer, curve.true_producer, ACCENT),
        ]
        floor = 1e-2
        for text, found, true, colour in lines:
            right.plot(curve.k, np.maximum(100 * found, floor), color=colour, lw=1.6, label=text)
            if np.isfinite(true).any():
                right.plot(
                    curve.k, np.maximum(100 * true, floor), color=colour, lw=1.0, ls=(0, (3, 2)), label=f"{text}, truth"
                )
        right.set_yscale("log")
        top = max(
            100 * float(np.nanmax(np.concatenate([one for _, a, b, _ in lines for one in (a, b[np.isfinite(b)])]))), 1.0
        )
        right.set_ylim(floor * 0.9, 1.5 * top)
        log_ticks(right.yaxis)
        right.set_ylabel("risk, % of all")
        right.legend(
            fontsize=9, ncols=4, loc="lower right", bbox_to_anchor=(1.0, 0.99), handlelength=1.3, columnspacing=0.9
        )
        for axes in (left, right):
            axes.set_xlabel("guard band, standard uncertainties")
            axes.set_xlim(float(curve.k[0]), float(curve.k[-1]))
            axes.grid(color=RULE, lw=0.5)
            axes.set_axisbelow(True)
            if rule.by_estimate and rule.guard_factor is not None:
                axes.axvline(rule.guard_factor, color=INK, lw=1.0)
        return Drawing(figure, name, "Accepted share and risks against the guard band")
