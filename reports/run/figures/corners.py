"""Corner plots of single devices from their posterior draws."""

from __future__ import annotations

from collections.abc import Sequence

import corner
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, NullFormatter, NullLocator

from pipeline.arrays import FloatArray

from ...html.style import ACCENT, TRUTH, Drawing, style

_BINS = 18


def corner_plot(
    labels: Sequence[str], draws: FloatArray, truths: Sequence[float], name: str, description: str
) -> Drawing | None:
    """One- and two-dimensional marginals; ``None`` if fewer than two quantities vary or there are too few draws.

    Parameters
    ----------
    labels : Q labels.
    draws : (n, Q) posterior draws; an axis is relative to its centre, so that it does not wrap.
    truths : Q true values in the same form; nan if unknown.
    """
    draws = draws[np.isfinite(draws).all(axis=1)]
    if draws.shape[0] < 20:
        return None
    moving = np.ptp(draws, axis=0) > 0
    if moving.sum() < 2:
        return None
    chosen = [int(k) for k in np.flatnonzero(moving)]
    sample = draws[:, chosen]
    # The central 99.5 % with a margin; truths far outside appear only in the table beside the plot.
    low, high = np.quantile(sample, [0.0025, 0.9975], axis=0)
    room = 0.15 * np.maximum(high - low, 1e-12)
    ranges = list(zip(low - room, high + room, strict=True))
    with style():
        figure = Figure(figsize=(4.7, 4.7))
        # Without the empty panels above the diagonal, which corner.corner makes: a panel takes 7 ms, whether or not it is kept.
        grid = figure.add_gridspec(len(chosen), len(chosen), wspace=0.05, hspace=0.05)
        for row, y in enumerate(chosen):
            for column, x in enumerate(chosen[: row + 1]):
                axes = figure.add_subplot(grid[row, column])
                if row == column:
                    _one_dimensional(axes, draws[:, x], ranges[row])
                else:
                    _two_dimensional(axes, draws[:, [x, y]], (ranges[column], ranges[row]))
                _show_truth(axes, truths[x], None if row == column else truths[y])
                _lay_out(
                    axes,
                    labels[x] if row == len(chosen) - 1 else "",
                    labels[y] if column == 0 < row else "",
                    diagonal=row == column,
                )
        figure.subplots_adjust(left=0.2, bottom=0.17, right=0.98, top=0.98)
        return Drawing(figure, name, description)


def _one_dimensional(axes: Axes, values: FloatArray, span: tuple[float, float]) -> None:
    counts, _, _ = axes.hist(values, bins=np.linspace(*span, _BINS + 1).tolist(), color=ACCENT, histtype="step")
    axes.set(xlim=span, ylim=(0.0, 1.1 * np.max(counts)))
    axes.yaxis.set_major_locator(NullLocator())


def _two_dimensional(axes: Axes, values: FloatArray, spans: tuple[tuple[float, float], tuple[float, float]]) -> None:
    corner.hist2d(
        values[:, 0],
        values[:, 1],
        ax=axes,
        bins=[_BINS, _BINS],
        range=list(spans),
        color=ACCENT,
        plot_datapoints=False,
        plot_density=False,
        fill_contours=True,
        levels=(0.393, 0.865),
        smooth=1.0,
        quiet=True,
        force_range=True,
    )


def _show_truth(axes: Axes, x: float, y: float | None) -> None:
    """Lines, and a point where both are known; ``y`` is ``None`` on the diagonal."""
    if np.isfinite(x):
        axes.axvline(x, color=TRUTH)
    if y is not None:
        if np.isfinite(y):
            axes.axhline(y, color=TRUTH)
        axes.plot([x], [y], marker="s", linestyle="none", color=TRUTH)


def _lay_out(axes: Axes, below: str, beside: str, *, diagonal: bool) -> None:
    """Ticks of a panel, and its labels at the edge of the plot; a side without a label has no numbers either."""
    axes.tick_params(labelsize=8.5, labelrotation=0, length=2)
    axes.spines[["top", "right"]].set_visible(True)
    axes.xaxis.set_major_locator(MaxNLocator(3, prune="both"))
    if below:
        axes.set_xlabel(below, fontsize=9.5)
    else:
        axes.xaxis.set_major_formatter(NullFormatter())
    axes.xaxis.set_label_coords(0.5, -0.36)
    if diagonal:
        return
    axes.yaxis.set_major_locator(MaxNLocator(3, prune="both"))
    if beside:
        axes.set_ylabel(beside, fontsize=9.5)
    else:
        axes.yaxis.set_major_formatter(NullFormatter())
    axes.yaxis.set_label_coords(-0.48, 0.5)
