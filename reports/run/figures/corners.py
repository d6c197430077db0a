"""Corner plots of single devices from their posterior draws."""

from __future__ import annotations

from collections.abc import Sequence

import corner
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from pipeline.arrays import FloatArray

from ...html.style import ACCENT, TRUTH, Drawing, style


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
    with style():
        figure = Figure(figsize=(4.7, 4.7))
        corner.corner(
            sample,
            bins=18,
            range=list(zip(low - room, high + room, strict=True)),
            labels=[labels[k] for k in chosen],
            truths=[truths[k] if np.isfinite(truths[k]) else None for k in chosen],
            truth_color=TRUTH,
            color=ACCENT,
            fig=figure,
            plot_datapoints=False,
            plot_density=False,
            fill_contours=True,
            levels=(0.393, 0.865),
            smooth=1.0,
            max_n_ticks=3,
            label_kwargs={"fontsize": 9.5},
            quiet=True,
        )
        count = len(chosen)
        for k, axes in enumerate(list(figure.axes)):
            row, column = divmod(k, count)
            if column > row:
                # Empty panels cost drawing time.
                figure.delaxes(axes)
                continue
            axes.tick_params(labelsize=8.5, labelrotation=0, length=2)
            axes.spines[["top", "right"]].set_visible(True)
            axes.xaxis.set_major_locator(MaxNLocator(3, prune="both"))
            axes.xaxis.set_label_coords(0.5, -0.36)
            if row != column:
                axes.yaxis.set_major_locator(MaxNLocator(3, prune="both"))
                axes.yaxis.set_label_coords(-0.48, 0.5)
        figure.subplots_adjust(left=0.2, bottom=0.17, right=0.98, top=0.98)
        return Drawing(figure, name, description)
