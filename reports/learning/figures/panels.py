"""Grids of panels with margins in inches.

Constrained layout draws every figure twice to learn what its labels need; here they are known.
"""

from __future__ import annotations

from typing import Any, Literal

from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullLocator

from ...html.style import WIDTH

Share = bool | Literal["none", "all", "row", "col"]


def plain(text: str) -> str:
    """A name as it stands: dollars would make it a formula."""
    return text.replace("$", r"\$")


def log_ticks(axis: Axis) -> None:
    """Plain numbers on a logarithmic axis: 1, 2, 5 of every decade, decades alone over many, round steps within one."""
    low, high = axis.get_view_interval()
    ratio = high / max(low, 1e-300)
    if ratio < 4.0:
        axis.set_major_locator(MaxNLocator(6, steps=[1, 2, 2.5, 5, 10]))
    else:
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if ratio < 300.0 else (1.0,), numticks=12))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_locator(NullLocator())


def panels(
    rows: int,
    columns: int,
    height: float,
    *,
    left: float = 0.75,
    right: float = 0.1,
    bottom: float = 0.95,
    top: float = 0.32,
    gap: float = 0.28,
    between: float = 0.3,
    sharex: Share = False,
    sharey: Share = False,
    height_ratios: tuple[float, ...] | None = None,
) -> tuple[Figure, list[list[Axes]]]:
    """A figure of the page's width and its axes, rows of columns, within ``style()``.

    Parameters
    ----------
    height : of a row [inch]; the figure grows with the rows.
    left, right, bottom, top : margins [inch].
    gap, between : between columns and between rows [inch].
    sharex, sharey, height_ratios : as of ``Figure.subplots``.
    """
    whole = rows * height + (rows - 1) * between + bottom + top
    wide = (WIDTH - left - right - (columns - 1) * gap) / columns
    figure = Figure(figsize=(WIDTH, whole))
    ratios: dict[str, Any] = {} if height_ratios is None else {"height_ratios": height_ratios}
    grid = figure.subplots(rows, columns, squeeze=False, sharex=sharex, sharey=sharey, **ratios)
    figure.subplots_adjust(
        left=left / WIDTH,
        right=1.0 - right / WIDTH,
        bottom=bottom / whole,
        top=1.0 - top / whole,
        wspace=gap / wide,
        hspace=between / height,
    )
    return figure, [list(row) for row in grid]
