"""Figure of a free decay: frequency and damping ratio of its pieces against amplitude, measured and by the models."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from pipeline.arrays import FloatArray
from pipeline.experiment.decays.backbone import Oscillation, backbone

from ...html.style import AFTER, BEFORE, Drawing, panels, style
from ..record_view import RecordView
from .records import Picture

_MEASURED = "#7b8794"
#: Relative sd of the damping ratio above which a piece shows too little to be drawn; one further mode takes more pieces.
_CLEAR = 0.35


def decay_pictures(
    before: Sequence[RecordView], after: Sequence[RecordView] | None, modes_hz: Sequence[float]
) -> tuple[Picture, ...]:
    """One figure for each mode of the records without a drive.

    Parameters
    ----------
    before, after : the records with the first and with the last model; ``after`` is ``None`` where there is only one model.
    modes_hz : frequencies of the modes of the model.
    """
    pieces = [(view, view) if after is None else (view, after[k]) for k, view in enumerate(before)]
    free = [(first, last) for first, last in pieces if first.drive_v.shape[1] == 0]
    if not free:
        return ()
    measured = [backbone(first.measured_v, first.sample_rate_hz, modes_hz) for first, _ in free]
    modelled = [
        [backbone(view.model_v, view.sample_rate_hz, modes_hz) for view in (pair if after is not None else pair[:1])]
        for pair in free
    ]
    held_out = [first.role == "validate" for first, _ in free]
    out = []
    for k, f_hz in enumerate(sorted(modes_hz)[: len(modes_hz) or 1] or [0.0]):
        rows = [(m, [_nearest(one, f_hz) for one in models]) for m, models in zip(measured, modelled)]
        marks = [(_nearest(m, f_hz), models, held) for (m, models), held in zip(rows, held_out)]
        clear = [(m, models, held) for m, models, held in marks if m is not None and m.zeta_sd < _CLEAR * abs(m.zeta)]
        if clear:
            what = f"mode near {f_hz:.5g} Hz, {len(clear)} of {len(free)} pieces" if f_hz else f"{len(clear)} pieces"
            out.append(Picture("free decay", "", what, _figure(clear, f"decay-{k}")))
    return tuple(out)


def _nearest(found: Sequence[Oscillation], f_hz: float) -> Oscillation | None:
    """The mode of a piece nearest to ``f_hz``; ``None`` where the piece does not determine it."""
    if not found:
        return None
    one = min(found, key=lambda o: abs(o.f_hz - f_hz)) if f_hz else found[0]
    return one if one.found else None


Mark = tuple[Oscillation, Sequence[Oscillation | None], bool]


def _figure(marks: Sequence[Mark], name: str) -> Drawing:
    with style():
        figure, grid = panels(1, 2, 2.6, left=0.85, bottom=0.55, top=0.12, gap=0.9)
        frequency, damping = grid[0]
        _measured(frequency, marks, np.array([[m.f_hz, m.f_sd_hz] for m, _, _ in marks]))
        _measured(damping, marks, 100.0 * np.array([[m.zeta, m.zeta_sd] for m, _, _ in marks]))
        for place, (colour, marker) in enumerate(((BEFORE, "x"), (AFTER, "+"))):
            own = [models[place] for _, models, _ in marks if place < len(models)]
            seen = [one for one in own if one is not None]
            if seen:
                label = "first model" if place == 0 else "last model"
                amplitude = [one.amplitude for one in seen]
                line: dict[str, Any] = {
                    "color": colour,
                    "marker": marker,
                    "ms": 5.0,
                    "lw": 0.7,
                    "label": label,
                    "zorder": 3,
                }
                frequency.plot(amplitude, [one.f_hz for one in seen], **line)
                damping.plot(amplitude, [100.0 * one.zeta for one in seen], **line)
        for axes, label in ((frequency, "frequency [Hz]"), (damping, "damping ratio [%]")):
            axes.set_xscale("log")
            axes.set_xlabel("amplitude [unit of the sense signal]")
            axes.set_ylabel(label)
        frequency.legend(loc="best", frameon=False)
        words = (
            "Frequency and damping ratio of the pieces of a free decay against amplitude, measured and by the models"
        )
        return Drawing(figure, name, words)


def _measured(axes: Axes, marks: Sequence[Mark], value: FloatArray) -> None:
    amplitude = np.array([m.amplitude for m, _, _ in marks])
    for held, face, label in ((False, _MEASURED, "measured"), (True, "white", "measured, held out")):
        own = np.array([mark[2] is held for mark in marks])
        if own.any():
            axes.errorbar(
                amplitude[own],
                value[own, 0],
                value[own, 1],
                fmt="o",
                ms=4.5,
                color=_MEASURED,
                mfc=face,
                lw=1.0,
                label=label,
            )
