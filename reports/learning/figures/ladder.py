"""The ladder: error and misfit, rung by rung, on fitted and on held-out records."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from matplotlib.axes import Axes
from matplotlib.patches import Patch

from ...html.style import INK, MUTED, RULE, style, to_svg
from ...run.figures.states import AFTER, BEFORE
from .panels import log_ticks, panels, plain

#: Marks of the status of a rung: colour, marker and words.
STATUS = {
    "confirmed": (AFTER, "o", "confirmed"),
    "partial": ("#9a7400", "D", "partial"),
    "refused": (BEFORE, "X", "refused"),
}
#: Below this a misfit is drawn at the edge: it is nothing that records of any length could show.
_LEAST = 1e-3
#: Half the width of a bar, in rungs.
_HALF = 0.14
#: Width of the column of a refused effect, in rungs.
_NARROW = 0.6


@dataclass(frozen=True)
class LadderPoint:
    """One model: errors and misfits, ``None`` where they are not known; ``status`` is "" on the ground."""

    label: str
    status: str
    error_fit: float | None
    error_validate: float | None
    misfit_fit: float | None
    misfit_validate: float | None


def ladder_plot(
    points: Sequence[LadderPoint], refused: Sequence[str] = (), relative: bool = False, name: str = "ladder"
) -> str:
    """Above the error with the noise floor at 1, below the misfit, on common rungs; refused effects to the right.

    ``relative``: the errors are relative ones, which have no floor and no misfit.
    """
    with style():
        if relative:
            figure, grid = panels(1, 1, 2.6, left=0.95, bottom=0.6, top=0.1)
        else:
            figure, grid = panels(
                2, 1, 2.0, left=0.9, bottom=0.6, top=0.1, between=0.16, sharex=True, height_ratios=(1.5, 1.0)
            )
        top, bottom = grid[0][0], None if relative else grid[1][0]
        _errors(top, points, relative)
        if bottom is not None:
            _misfits(bottom, points)
        lowest = bottom if bottom is not None else top
        width = min(max(110 // (len(points) + len(refused)), 9), 24)
        names = [*(one.label for one in points), *refused]
        labels = [textwrap.fill(plain(name), width, break_long_words=False) for name in names]
        edge = len(points) - 0.4
        places = [*range(len(points)), *(edge + _NARROW * (j + 0.5) for j in range(len(refused)))]
        lowest.set_xticks(places, labels)
        lowest.set_xlim(-0.4, edge + _NARROW * len(refused))
        if refused:
            for axes in filter(None, (top, bottom)):
                axes.axvspan(edge, edge + _NARROW * len(refused), color="#f4f6f8", lw=0, zorder=0)
        for place in places[len(points) :]:
            top.plot([place], [0.5], "X", ms=9, color=BEFORE, transform=top.get_xaxis_transform())
            top.text(place, 0.4, "refused", transform=top.get_xaxis_transform(), ha="center", va="top", color=BEFORE)
        return to_svg(figure, name, "Error and misfit of each model of the ladder, on fitted and on held-out records")


def _errors(axes: Axes, points: Sequence[LadderPoint], relative: bool) -> None:
    errors = [(p.error_fit, p.error_validate) for p in points]
    known = [v for pair in errors for v in pair if v is not None and math.isfinite(v) and v > 0.0]
    axes.set_yscale("log")
    if known:
        low, high = min([*known, *([] if relative else [1.0])]), max([*known, *([] if relative else [1.02])])
        room = max(high / low, 1.05)
        axes.set_ylim(low / room ** (0.4 if relative else 0.12), high * room**0.42)
    _bars(axes, points, errors, axes.get_ylim()[0] if relative else 1.0)
    if not relative:
        axes.axhline(1.0, color=INK, lw=1.0, ls=(0, (4, 2)), zorder=4)
        axes.annotate(
            "noise floor", (1.0, 1.0), xycoords=("axes fraction", "data"), xytext=(-2, 4),
            textcoords="offset points", ha="right", color=INK, fontsize=9.5,
        )  # fmt: skip
    for k, point in enumerate(points):
        _label(axes, k, point, relative)
    log_ticks(axes.yaxis)
    axes.set_ylabel("relative error" if relative else "error")
    handles = [
        Patch(fc="#c3ccd5", label="fitted records"),
        *([] if relative else [Patch(fc=MUTED, label="held-out records")]),
    ]
    axes.legend(handles=handles, loc="upper right", ncols=2, borderaxespad=0.0)


def _label(axes: Axes, k: int, point: LadderPoint, relative: bool) -> None:
    """The errors above their bars, the held-out one with the status."""
    fit, held = point.error_fit, point.error_validate
    colour, _, words = STATUS.get(point.status, (INK, "s", plain(point.status)))
    shown = _percent if relative else _short
    beside: dict[str, Any] = {
        "textcoords": "offset points",
        "xytext": (0, 4),
        "ha": "center",
        "va": "bottom",
        "zorder": 6,
    }
    floor = 0.0 if relative else 1.0
    main = held if held is not None else fit
    if fit is not None and held is not None:
        axes.annotate(shown(fit), (k - _HALF, max(fit, floor)), color=MUTED, fontsize=10.5, **beside)
    if main is not None:
        at = k + (_HALF if held is not None and fit is not None else 0.0)
        axes.annotate(
            (f"{words}\n" if words else "") + shown(main), (at, max(main, floor)), color=colour, weight="bold", fontsize=12,
            linespacing=1.15, **beside,
        )  # fmt: skip


def _misfits(axes: Axes, points: Sequence[LadderPoint]) -> None:
    misfits = [(p.misfit_fit, p.misfit_validate) for p in points]
    known = [max(v, _LEAST) for pair in misfits for v in pair if v is not None and math.isfinite(v)]
    axes.set_yscale("log")
    if known:
        axes.set_ylim(min(known) / 2.0, max([*known, 10.0 * min(known)]) * 2.0)
        if min(known) <= _LEAST:
            words = f"at the lower edge: {_LEAST:g} or less"
            axes.text(0.996, 0.86, words, transform=axes.transAxes, color=MUTED, fontsize=9, ha="right")
    _bars(axes, points, [(_edged(a), _edged(b)) for a, b in misfits], axes.get_ylim()[0])
    log_ticks(axes.yaxis)
    axes.set_ylabel("misfit")


def _edged(misfit: float | None) -> float | None:
    return None if misfit is None else max(misfit, _LEAST)


def _bars(
    axes: Axes, points: Sequence[LadderPoint], pairs: Sequence[tuple[float | None, float | None]], floor: float
) -> None:
    """A pale bar for the fitted records, a strong one in the colour of the status for the held-out ones, from ``floor``."""
    for k, (point, (fit, held)) in enumerate(zip(points, pairs)):
        colour = STATUS.get(point.status, (BEFORE, "", ""))[0]
        alone = fit is None or held is None
        for value, at, alpha in ((fit, -_HALF, 0.4), (held, _HALF, 1.0)):
            if value is not None and math.isfinite(value) and value > 0.0:
                place = k + (0.0 if alone else at)
                # A bar of no height still shows that there is a value.
                axes.plot([place - _HALF, place + _HALF], [value, value], color=colour, lw=2.0, alpha=alpha, zorder=3)
                axes.bar(place, value - floor, 2.0 * _HALF, floor, color=colour, alpha=alpha, lw=0, zorder=2)
    axes.grid(axis="y", color=RULE, lw=0.5)
    axes.set_axisbelow(True)


def _percent(value: float) -> str:
    return f"{100.0 * value:.2g} %"


def _short(value: float) -> str:
    return f"{value:.3g}" if value >= 10.0 or value < 0.1 else f"{value:.2f}"
