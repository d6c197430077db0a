"""The paper's route and the posterior: error of theta and of the split against the split."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from pipeline.arrays import FloatArray

from ...html.style import ACCENT, COLOURS, POINTS, RULE, Drawing, style
from ...html.style import panels as laid_out
from ...words.quantities import SUPERSCRIPT


def route_scatter(
    split_hz: FloatArray,
    panels: Sequence[tuple[str, FloatArray, FloatArray | None]],
    name: str = "route",
) -> Drawing:
    """For each (label, |error| of the route, |error| of the posterior or None) a doubly logarithmic panel.

    Parameters
    ----------
    split_hz : (B,) split [Hz]; errors are (B,) in the unit of their label, nan is not drawn.
    """
    step = max(1, -(-split_hz.size // POINTS))
    with style():
        figure, grid = laid_out(1, len(panels), 2.65, bottom=0.5, top=0.35, gap=0.75)
        for axes, (label, route, posterior) in zip(grid[0], panels, strict=True):
            drawn = [("the paper's route", route, COLOURS["fail"], "x"), ("posterior", posterior, ACCENT, "o")]
            for legend, error, colour, marker in drawn:
                if error is None:
                    continue
                known = np.isfinite(error) & np.isfinite(split_hz) & (error > 0) & (split_hz > 0)
                x, y = split_hz[known][::step], error[known][::step]
                axes.plot(x, y, ls="none", marker=marker, ms=3.2, mew=0.7, color=colour, alpha=0.8, label=legend)
            if axes.lines and any(np.size(line.get_xdata()) for line in axes.lines):
                axes.set(xscale="log", yscale="log")
                # Labels between the decades would overlap.
                axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
                axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
                axes.yaxis.set_major_formatter(FuncFormatter(_power_of_ten))
                # Minor ticks of many decades take a fifth of a second.
                axes.xaxis.set_minor_locator(NullLocator())
                axes.yaxis.set_minor_locator(NullLocator())
            axes.set(xlabel="split, Hz", ylabel=label)
            axes.grid(color=RULE, lw=0.5)
            # Above the panel: the search for the best place among 1400 points takes a tenth of a second.
            axes.legend(ncols=2, loc="lower right", bbox_to_anchor=(1.0, 0.99), handletextpad=0.2)
        return Drawing(figure, name, "Error of the paper's route and of the posterior against the split")


def _power_of_ten(value: float, _: object) -> str:
    # matplotlib's own labels are formulas, and setting formulas takes a tenth of the page's time.
    return f"10{str(round(np.log10(value))).translate(SUPERSCRIPT)}"
