"""The ladder: error and misfit, rung by rung, on fitted and on held-out records."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from .panels import panels, plain
from .states import AFTER, BEFORE
from .style import INK, MUTED, RULE, style, to_svg

#: Marks of the status of a rung: colour, marker and words.
STATUS = {
    "confirmed": (AFTER, "o", "confirmed"),
    "partial": ("#9a7400", "D", "partial"),
    "refused": (BEFORE, "X", "refused"),
}
#: Below this a misfit is drawn at the edge: it is nothing that records of any length could show.
_LEAST = 1e-3
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
            figure, grid = panels(2, 1, 2.0, bottom=0.6, top=0.1, between=0.16, sharex=True, height_ratios=(1.5, 1.0))
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
    known = _lines(axes, points, lambda p: p.error_fit, lambda p: p.error_validate, 0.0)
    if not relative:
        axes.axhline(1.0, color=INK, lw=1.0, ls=(0, (4, 2)), zorder=1)
        axes.annotate(
            "noise floor", (1.0, 1.0), xycoords=("axes fraction", "data"), xytext=(-2, -11),
            textcoords="offset points", ha="right", color=INK, fontsize=9.5,
        )  # fmt: skip
    if known:
        low, high = min([*known, *([] if relative else [1.0])]), max([*known, *([] if relative else [1.3])])
        room = max(high / low, 1.2)
        axes.set_yscale("log")
        axes.set_ylim(low / room**0.16, high * room**0.38)
    for k, point in enumerate(points):
        _label(axes, k, point, relative)
    _log_ticks(axes)
    axes.set_ylabel("relative error" if relative else "error")
    handles = [
        *([] if relative else [Line2D([], [], color=AFTER, lw=1.8, marker="o", ms=6, label="held-out records")]),
        Line2D([], [], color=MUTED, lw=1.2, marker="o", mfc="white", ms=6, label="fitted records"),
    ]
    axes.legend(handles=handles, loc="upper right", ncols=2, borderaxespad=0.0)


def _label(axes: Axes, k: int, point: LadderPoint, relative: bool) -> None:
    """The held-out error with the status, and the fitted one where the two would not run into each other."""
    fit, held = point.error_fit, point.error_validate
    colour, _, words = STATUS.get(point.status, (INK, "s", plain(point.status)))
    main = held if held is not None else fit
    apart = fit is not None and held is not None and not 0.8 < fit / held < 1.25
    if main is None:
        return
    shown = _percent if relative else _short
    beside: dict[str, Any] = {
        "textcoords": "offset points",
        "xytext": (10, 4),
        "ha": "left",
        "va": "bottom",
        "zorder": 6,
    }
    axes.annotate(
        shown(main) + (f"\n{words}" if words else ""), (k, main), color=colour, weight="bold", fontsize=12,
        linespacing=1.1, **beside,
    )  # fmt: skip
    if apart and fit is not None:
        axes.annotate(shown(fit), (k, fit), color=MUTED, fontsize=10.5, **beside)


def _misfits(axes: Axes, points: Sequence[LadderPoint]) -> None:
    known = _lines(axes, points, lambda p: p.misfit_fit, lambda p: p.misfit_validate, _LEAST)
    if known:
        low, high = min(known), max(known)
        axes.set_yscale("log")
        axes.set_ylim(max(low, _LEAST) / 2.0, max(high, 10 * low) * 2.0)
        if low <= _LEAST:
            axes.text(
                0.004, 0.05, f"at the edge: {_LEAST:g} or less", transform=axes.transAxes, color=MUTED, fontsize=9
            )
    _log_ticks(axes)
    axes.set_ylabel("misfit √(error² − 1)")


def _lines(
    axes: Axes,
    points: Sequence[LadderPoint],
    fit: Callable[[LadderPoint], float | None],
    held: Callable[[LadderPoint], float | None],
    least: float,
) -> list[float]:
    """Draws both lines; the values drawn."""
    drawn: list[float] = []
    for of, is_held in ((fit, False), (held, True)):
        at = [
            (k, max(value, least), points[k].status)
            for k, value in enumerate(map(of, points))
            if value is not None and math.isfinite(value) and (value > 0.0 or least)
        ]
        drawn += [value for _, value, _ in at]
        colour = AFTER if is_held else MUTED
        climbed = [(k, v) for k, v, status in at if status != "refused"]
        axes.plot([k for k, _ in climbed], [v for _, v in climbed], color=colour, lw=1.8 if is_held else 1.2, zorder=2)
        for k, value, status in at:
            mark, shape, _ = STATUS.get(status, (INK, "s", ""))
            axes.plot(
                [k], [value], marker=shape, ms=8 if is_held else 6.5, mfc=mark if is_held else "white", mec=mark,
                mew=1.2, zorder=3 + is_held,
            )  # fmt: skip
    axes.grid(axis="y", color=RULE, lw=0.5)
    return drawn


def _log_ticks(axes: Axes) -> None:
    if axes.get_yscale() != "log":
        return
    low, high = axes.get_ylim()
    few = high / low < 300.0
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if few else (1.0,), numticks=12))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.yaxis.set_minor_locator(NullLocator())


def _percent(value: float) -> str:
    return f"{100.0 * value:.2g} %"


def _short(value: float) -> str:
    return f"{value:.3g}" if value >= 10.0 or value < 0.1 else f"{value:.2f}"
