"""The ladder: error and misfit, rung by rung, on fitted and on held-out records."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from .states import AFTER, BEFORE
from .style import INK, MUTED, RULE, WIDTH, style, to_svg

#: Marks of the status of a rung: colour, marker and words.
STATUS = {
    "confirmed": (AFTER, "o", "confirmed"),
    "partial": ("#9a7400", "D", "partial"),
    "refused": (BEFORE, "X", "refused"),
}
#: Below this a misfit is drawn at the edge: it is nothing that records of any length could show.
_LEAST = 1e-3


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
        figure = Figure(figsize=(WIDTH, 3.6 if relative else 5.0), layout="constrained")
        if relative:
            top, bottom = figure.subplots(1, 1, squeeze=False)[0][0], None
        else:
            top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=[1.5, 1.0])
        _errors(top, points, relative)
        if bottom is not None:
            _misfits(bottom, points)
        lowest = bottom if bottom is not None else top
        labels = [textwrap.fill(one.label, 17, break_long_words=False) for one in points]
        labels += [textwrap.fill(one, 17, break_long_words=False) for one in refused]
        lowest.set_xticks(range(len(labels)), labels)
        lowest.set_xlim(-0.5, max(len(labels), 2) - 0.5)
        for k in range(len(points), len(labels)):
            for axes in filter(None, (top, bottom)):
                axes.axvspan(k - 0.5, k + 0.5, color="#f4f6f8", lw=0, zorder=0)
            top.text(k, 0.5, "refused", transform=top.get_xaxis_transform(), ha="center", color=BEFORE, fontsize=10.5)
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
        axes.set_ylim(low / room**0.22, high * room**0.32)
    for k, point in enumerate(points):
        value = point.error_validate if point.error_validate is not None else point.error_fit
        if value is None or not math.isfinite(value):
            continue
        top = max(v for v in (point.error_fit, point.error_validate) if v is not None and math.isfinite(v))
        colour, _, words = STATUS.get(point.status, (INK, "s", point.status))
        axes.annotate(
            _short(value) + (f"\n{words}" if words else ""), (k, top), xytext=(0, 9), textcoords="offset points",
            ha="center", va="bottom", fontsize=10.5, color=colour, weight="bold", linespacing=1.15,
        )  # fmt: skip
    _log_ticks(axes)
    axes.set_ylabel("relative error" if relative else "error")
    handles = [
        Line2D([], [], color=AFTER, lw=1.8, marker="o", ms=6, label="held-out records"),
        Line2D([], [], color=MUTED, lw=1.2, marker="o", mfc="white", ms=6, label="fitted records"),
    ]
    axes.legend(handles=handles, loc="upper right", ncols=2, borderaxespad=0.0)


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
        axes.plot([k for k, *_ in at], [v for _, v, _ in at], color=colour, lw=1.8 if is_held else 1.2, zorder=2)
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
    axes.yaxis.set_minor_formatter(NullFormatter())


def _short(value: float) -> str:
    return f"{value:.3g}" if value >= 10.0 or value < 0.1 else f"{value:.2f}"
