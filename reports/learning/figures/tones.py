"""Figures of sweeps and frequency responses: size and phase against frequency, the Nyquist plane, and the residual."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from pipeline.arrays import ComplexArray, FloatArray
from pipeline.experiment.tones import ToneRecord, passes_of

from ...html.style import AFTER, BEFORE, INK, WIDTH, Drawing, literal, panels, style
from ..tone_view import ToneView
from .records import Picture

#: Most figures, passes in a figure, and points of a pass.
_FIGURES, _PASSES, _POINTS = 8, 8, 400
_MEASURED = "#7b8794"
_UP, _DOWN = "o", "s"


def tone_pictures(before: Sequence[ToneView], after: Sequence[ToneView]) -> tuple[Picture, ...]:
    """One figure for each record, level and channel: measured, and the first and the last model.

    Parameters
    ----------
    before, after : the passes with the first and with the last model; ``after`` is empty where there is only one model.
    """
    found: list[Picture] = []
    pairs = list(zip(before, after)) if after else [(view, None) for view in before]
    for (record, level), group in groupby(pairs, key=lambda pair: (pair[0].record, f"{pair[0].level_v.mean():.4g}")):
        own = list(group)
        for channel in range(own[0][0].measured_v.shape[1]):
            if len(found) == _FIGURES:
                return tuple(found)
            first = own[0][0]
            note = " (held out)" if first.role == "validate" else ""
            what = f"sense {channel + 1}, {first.label if len(own) == 1 else f'{len(own)} passes'}, drive {level} V"
            found.append(Picture(record, note, what, _figure(own[:_PASSES], channel, f"tones-{len(found)}")))
    return tuple(found)


Pair = tuple[ToneView, ToneView | None]


def _figure(pairs: Sequence[Pair], channel: int, name: str) -> Drawing:
    """Size and phase on the left, the Nyquist plane on the right, the residual below."""
    with style():
        figure, grid = panels(3, 2, 1.75, left=0.85, bottom=0.85, top=0.1, gap=0.8, between=0.18)
        nyquist = grid[0][1]
        bottom = grid[2][1].get_position()
        for row in (1, 2):
            figure.delaxes(grid[row][1])
        place = nyquist.get_position()
        nyquist.set_position((place.x0, bottom.y0, place.width, place.y1 - bottom.y0))
        size, phase, residual = (grid[row][0] for row in range(3))
        for axes in (size, phase):
            axes.tick_params(labelbottom=False)
        largest = max(float(np.abs(view.measured_v[:, channel]).max()) for view, _ in pairs)
        unit, factor = fitting_unit(largest)
        for first, last in pairs:
            _pass(size, phase, nyquist, residual, first, last, channel, factor)
        span = [float(np.abs(view.measured_v[:, channel]).min()) for view, _ in pairs]
        if min(span) > 0.0 and largest / min(span) > 30.0:
            size.set_yscale("log")
        residual.set_yscale("log")
        residual.axhline(1.0, color=INK, lw=0.8, ls=(0, (4, 2)))
        size.set_ylabel(f"size, {unit}")
        phase.set_ylabel("phase, deg")
        residual.set_ylabel("residual, σ")
        residual.set_xlabel("frequency, Hz")
        nyquist.set_xlabel(f"real part, {unit}")
        nyquist.set_ylabel(f"imaginary part, {unit}")
        nyquist.set_aspect("equal", adjustable="datalim")
        _legend(figure_axes=nyquist, both=pairs[0][1] is not None)
        return Drawing(figure, name, "Measured response, model and residual against frequency and in the Nyquist plane")


def tones_png(records: Sequence[ToneRecord], path: Path) -> None:
    """Write what was read of each record to ``path`` (PNG): size and phase of each sense against frequency.

    Raises
    ------
    OSError : the file cannot be written.
    """
    with style():
        tones_figure(records).savefig(path, format="png", dpi=110)


def tones_figure(records: Sequence[ToneRecord]) -> Figure:
    """What was read of each record: size and phase of each sense against frequency; at most eight."""
    rows = [(record, k) for record in records[:_FIGURES] for k in range(record.sense_v.shape[1])][:_FIGURES]
    with style():
        figure = Figure(figsize=(WIDTH, 1.0 + 1.9 * len(rows)), layout="constrained")
        grid = figure.subplots(len(rows), 2, squeeze=False)
        for (left, right), (record, k) in zip(grid, rows):
            y = record.sense_v[:, k]
            unit, factor = fitting_unit(float(np.abs(y).max(initial=0.0)))
            for own in passes_of((record,)):
                f = record.frequency_hz[own.rows]
                look: dict[str, Any] = {"lw": 0.8, "ls": "--" if own.direction == "down" else "-", "color": AFTER}
                left.plot(f, np.abs(y[own.rows]) * factor, **look)
                right.plot(f, _degrees(y[own.rows]), **look)
            left.set_ylabel(f"sense {k + 1}, {unit}")
            right.set_ylabel("phase, deg")
            left.set_title(literal(record.name))
        for axes in grid[-1]:
            axes.set_xlabel("frequency, Hz (dashed: down)")
        return figure


def fitting_unit(largest: float) -> tuple[str, float]:
    """A unit in which numbers are short, and the factor to it."""
    for unit, factor in (("V", 1.0), ("mV", 1e3), ("µV", 1e6), ("nV", 1e9)):
        if largest * factor >= 0.5:
            return unit, factor
    return "pV", 1e12


def _pass(
    size: Axes,
    phase: Axes,
    nyquist: Axes,
    residual: Axes,
    first: ToneView,
    last: ToneView | None,
    channel: int,
    factor: float,
) -> None:
    every = max(1, first.frequency_hz.size // _POINTS)
    f = first.frequency_hz[::every]
    marker = _DOWN if f.size > 1 and f[-1] < f[0] else _UP
    measured = first.measured_v[::every, channel] * factor
    dots: dict[str, Any] = {"ls": "none", "marker": marker, "ms": 2.2, "color": _MEASURED, "zorder": 2}
    size.plot(f, np.abs(measured), **dots)
    phase.plot(f, _degrees(measured), **dots)
    nyquist.plot(measured.real, measured.imag, **dots)
    for view, colour in (
        (first, BEFORE if last is not None else AFTER),
        *(((last, AFTER),) if last is not None else ()),
    ):
        model = view.model_v[::every, channel] * factor
        line: dict[str, Any] = {"color": colour, "lw": 1.1, "zorder": 3}
        size.plot(f, np.abs(model), **line)
        phase.plot(f, _degrees(model), **line)
        nyquist.plot(model.real, model.imag, **line)
        residual.plot(f, np.maximum(view.residual[::every, channel], 1e-2), color=colour, lw=0.8, alpha=0.8)


def _degrees(y: ComplexArray) -> FloatArray:
    angle = np.rad2deg(np.angle(y))
    # A line across the wrap would look like a jump of the response.
    wrapped = np.flatnonzero(np.abs(np.diff(angle)) > 180.0)
    angle[wrapped] = np.nan
    return np.asarray(angle)


def _legend(figure_axes: Axes, both: bool) -> None:
    handles = [Line2D([], [], ls="none", marker=_UP, ms=4, color=_MEASURED, label="measured (up; squares: down)")]
    if both:
        handles.append(Line2D([], [], color=BEFORE, label="first model"))
    handles.append(Line2D([], [], color=AFTER, label="last model" if both else "model"))
    figure_axes.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=3, fontsize=9)
