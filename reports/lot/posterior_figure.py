"""Figure: the posterior of the most influential spreads beside their REML intervals."""

from __future__ import annotations

import numpy as np

from pipeline.learning.lot.posterior import LotPosteriorAnswer

from ..html.style import ACCENT, INK, MUTED, RULE, Drawing, panels, style


def posterior_figure(answer: LotPosteriorAnswer, name: str = "posterior") -> Drawing:
    """Median and 90 % interval of each spread over that of the file, with the REML estimate and interval below it."""
    at = np.arange(len(answer.spreads))[::-1]
    ends = np.array([[one.low, one.high, one.reml_low, one.reml_high] for one in answer.spreads.values()])
    most = 1.1 * float(np.max(ends, where=np.isfinite(ends), initial=1.0))
    with style():
        figure, ((axes,),) = panels(1, 1, 0.5 * len(at) + 0.4, left=2.6, right=0.2, bottom=0.6)
        axes.axvline(1.0, color=INK, lw=0.8)
        for place, one in zip(at, answer.spreads.values()):
            first = place == at[0]
            axes.plot([one.low, one.high], [place + 0.13] * 2, color=ACCENT, lw=2.4)
            axes.plot([one.median], [place + 0.13], "o", color=ACCENT, ms=6, label="posterior" if first else None)
            axes.plot([one.reml_low, min(one.reml_high, most)], [place - 0.15] * 2, color=MUTED, lw=1.6)
            axes.plot([one.reml], [place - 0.15], "s", color=MUTED, ms=5, label="REML" if first else None)
        axes.set_yticks(at, list(answer.spreads))
        axes.set_ylim(-0.6, len(at) - 0.4)
        axes.set_xlim(0.0, most)
        axes.grid(axis="x", color=RULE, lw=0.6)
        axes.set_xlabel("ratio of the spread, with its 90 % interval; 1: as stated")
        axes.legend(loc="best", frameon=False)
        return Drawing(figure, name, "Posterior and REML intervals of the most influential spreads")
