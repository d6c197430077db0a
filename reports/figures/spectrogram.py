"""The residual over time and frequency, in units of the noise, with the drive and its harmonics drawn in."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.lines import Line2D

from pipeline.arrays import FloatArray

from ..record_view import TimeFrequency
from .states import AFTER
from .style import WIDTH, style, to_svg

#: Steps of the colour scale; few, so that the picture stays small.
_STEPS = 12
_HARMONICS = (1, 2, 3, 4, 5)


@dataclass(frozen=True, eq=False)
class SpectrogramRow:
    """Pictures of one band [Hz], one a model, that share a scale."""

    label: str
    band_hz: tuple[float, float]
    pictures: tuple[TimeFrequency, ...]


def spectrograms(
    rows: Sequence[SpectrogramRow], titles: Sequence[str], times_s: FloatArray, drives_hz: FloatArray, name: str
) -> str:
    """Rows are bands, columns the models; white is the noise.

    Parameters
    ----------
    rows, titles : pictures, and the name of each column.
    times_s, drives_hz : (T,) and (D, T), the drives' instantaneous frequencies; no rows where there is none.
    """
    top = max(float(np.quantile(p.over_noise_db, 0.999)) for row in rows for p in row.pictures)
    ceiling = float(np.clip(5.0 * np.ceil(top / 5.0), 15.0, 80.0))
    colours = matplotlib.colormaps["magma_r"].resampled(_STEPS)
    with style():
        figure = Figure(figsize=(WIDTH, 2.45 * len(rows) + 0.75), layout="constrained")
        grid = figure.subplots(len(rows), len(titles), sharex=True, sharey="row", squeeze=False)
        image: AxesImage | None = None
        for k, row in enumerate(rows):
            for axes, picture in zip(grid[k], row.pictures, strict=True):
                image = axes.imshow(
                    np.clip(picture.over_noise_db, 0.0, ceiling),
                    origin="lower",
                    aspect="auto",
                    interpolation="none",
                    cmap=colours,
                    vmin=0.0,
                    vmax=ceiling,
                    extent=_extent(picture),
                )
                _harmonics(axes, times_s, drives_hz, row.band_hz)
                axes.set_ylim(*row.band_hz)
            grid[k][0].set_ylabel(row.label)
        for axes, title in zip(grid[0], titles, strict=True):
            axes.set_title(title)
        for axes in grid[-1]:
            axes.set_xlabel("time, s")
        if image is not None:
            bar = figure.colorbar(image, ax=grid.ravel().tolist(), shrink=0.85, pad=0.015, aspect=30)
            bar.set_label("residual over the noise, dB")
        if drives_hz.shape[0]:
            handles = [
                Line2D([], [], color=AFTER, lw=1.3, label="drive"),
                Line2D([], [], color=AFTER, lw=0.9, ls=(0, (2, 2)), label="its harmonics"),
            ]
            figure.legend(handles=handles, loc="outside lower left", ncols=2)
        return to_svg(figure, name, "Residual over time and frequency in units of the noise")


def _extent(picture: TimeFrequency) -> tuple[float, float, float, float]:
    def ends(x: FloatArray) -> tuple[float, float]:
        half = 0.5 * float(x[1] - x[0]) if x.size > 1 else 0.5
        return float(x[0]) - half, float(x[-1]) + half

    return *ends(picture.time_s), *ends(picture.frequency_hz)


def _harmonics(axes: Axes, times_s: FloatArray, drives_hz: FloatArray, band_hz: tuple[float, float]) -> None:
    for drive in drives_hz:
        for order in _HARMONICS:
            line = order * drive
            inside = np.where((line >= band_hz[0]) & (line <= band_hz[1]), line, np.nan)
            if np.isfinite(inside).any():
                solid = order == 1
                axes.plot(
                    times_s, inside, color=AFTER, lw=1.3 if solid else 0.9, ls="-" if solid else (0, (2, 2)), alpha=0.85
                )
