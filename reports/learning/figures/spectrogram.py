"""The residual over time and frequency, in units of the noise, with the drive and its harmonics drawn in."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.image import AxesImage
from matplotlib.lines import Line2D

from pipeline.arrays import FloatArray

from ...html.style import WIDTH, style, to_svg
from ...run.figures.states import AFTER
from ..record_view import TimeFrequency
from .panels import panels

#: Step of the colour scale [dB]; coarse, so that the picture stays small.
_STEP_DB = 5.0
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
    ceiling = float(np.clip(_STEP_DB * np.ceil(top / _STEP_DB), 15.0, 80.0))
    colours = _scale(round(ceiling / _STEP_DB))
    with style():
        figure, grid = panels(
            len(rows), len(titles), 2.1, left=0.85, right=1.05, between=0.18, gap=0.2, sharex=True, sharey="row"
        )
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
            height = figure.get_size_inches()[1]
            place = figure.add_axes((1.0 - 0.9 / WIDTH, 0.95 / height, 0.14 / WIDTH, 1.0 - 1.27 / height))
            bar = figure.colorbar(image, cax=place)
            bar.set_label("residual over the noise, dB")
        if drives_hz.shape[0]:
            handles = [
                Line2D([], [], color=AFTER, lw=1.3, label="drive"),
                Line2D([], [], color=AFTER, lw=0.9, ls=(0, (2, 2)), label="its harmonics"),
            ]
            figure.legend(handles=handles, loc="lower left", ncols=2)
        return to_svg(figure, name, "Residual over time and frequency in units of the noise")


def _scale(steps: int) -> ListedColormap:
    """White for the noise, then darker step by step."""
    shades = matplotlib.colormaps["magma_r"](np.linspace(0.12, 1.0, steps - 1))
    return ListedColormap(["white", *(tuple(shade) for shade in shades)])


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
