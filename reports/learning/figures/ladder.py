"""Figures of the ladder: error and misfit of each model; for a modal record its residues and the four thetas of each model."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from typing import Any

from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter

from pipeline.learning.answers import Measured, Place, RungAnswer

from ...html.style import ACCENT, AFTER, BEFORE, INK, MUTED, RULE, Drawing, literal, log_ticks, panels, style
from ...words.campaign import FIRST_MODEL, effect_words, rung_name
from ...words.quantities import entry_words, error_words

#: Colour of the status of a rung.
_COLOURS = {"confirmed": AFTER, "partial": "#9a7400"}
#: A misfit below this is drawn at the lower edge: no record is long enough to show it.
_LEAST_MISFIT = 1e-3
#: Half the width of a bar, and the width of the column of a refused effect, in rungs.
_HALF, _NARROW = 0.14, 0.6
_REFUSED_SHOWN = 4
#: Characters of the names of models that fit side by side below the axes.
_CHARACTERS = 125
_FOUR = (("u₁", "s"), ("v₁", "o"), ("u₂", "D"), ("v₂", "^"))
#: Offsets of the names of entries [points] that keep neighbours apart.
_OFFSETS = ((9, 3), (9, -11), (-37, 3), (-37, -11))


def ladder_plot(ladder: Sequence[RungAnswer], refused: Sequence[str] = ()) -> Drawing | None:
    """Error [sigma] of each model above, its misfit below; refused effects to the right.  ``None`` for a single model.

    Where no error in sigmas is known, the relative error alone: it has neither a noise floor nor a misfit.
    """
    if len(ladder) + len(refused) < 2:
        return None
    relative = not any(rung.error_fit or rung.error_validate for rung in ladder)
    errors = [(r.relative_error, None) if relative else (r.error_fit, r.error_validate) for r in ladder]
    with style():
        if relative:
            figure, grid = panels(1, 1, 2.6, left=0.95, bottom=0.6, top=0.1)
        else:
            figure, grid = panels(
                2, 1, 2.0, left=0.9, bottom=0.6, top=0.1, between=0.16, sharex=True, height_ratios=(1.5, 1.0)
            )
            _misfits(grid[1][0], ladder)
        _errors(grid[0][0], ladder, errors, relative)
        _names(grid[-1][0], ladder, refused[:_REFUSED_SHOWN])
        for k in range(len(refused[:_REFUSED_SHOWN])):
            left = len(ladder) - 0.4 + _NARROW * k
            for (axes,) in grid:
                axes.axvspan(left, left + _NARROW, color="#f4f6f8", lw=0, zorder=0)
            top = grid[0][0].get_xaxis_transform()
            grid[0][0].text(left + 0.5 * _NARROW, 0.4, "refused", transform=top, ha="center", va="top", color=BEFORE)
        return Drawing(
            figure, "ladder", "Error and misfit of each model of the ladder, on fitted and on held-out records"
        )


def _names(axes: Axes, ladder: Sequence[RungAnswer], refused: Sequence[str]) -> None:
    edge = len(ladder) - 0.4
    # As many characters of the axis' font as fit on a rung; a refused effect has a narrower column.
    room = _CHARACTERS / (edge + 0.4 + _NARROW * len(refused))
    names = [
        *(_folded(rung_name(rung.effect), room) for rung in ladder),
        *(_folded(effect_words(name), _NARROW * room) for name in refused),
    ]
    places = [*range(len(ladder)), *(edge + _NARROW * (k + 0.5) for k in range(len(refused)))]
    axes.set_xticks(places, names)
    axes.set_xlim(-0.4, edge + _NARROW * len(refused))


def _folded(name: str, room: float) -> str:
    return textwrap.fill(literal(name), min(max(int(room) - 1, 9), 24), break_long_words=False)


Pairs = Sequence[tuple[float | None, float | None]]


def _errors(axes: Axes, ladder: Sequence[RungAnswer], errors: Pairs, relative: bool) -> None:
    known = [value for pair in errors for value in pair if value is not None and math.isfinite(value) and value > 0.0]
    axes.set_yscale("log")
    if known:
        low, high = min([*known, *([] if relative else [1.0])]), max([*known, *([] if relative else [1.02])])
        room = max(high / low, 1.05)
        axes.set_ylim(low / room ** (0.4 if relative else 0.12), high * room**0.42)
    floor = axes.get_ylim()[0] if relative else 1.0
    _bars(axes, ladder, errors, floor)
    if not relative:
        axes.axhline(1.0, color=INK, lw=1.0, ls=(0, (4, 2)), zorder=4)
        axes.annotate(
            "noise floor", (1.0, 1.0), xycoords=("axes fraction", "data"), xytext=(-2, 4),
            textcoords="offset points", ha="right", color=INK, fontsize=9.5,
        )  # fmt: skip
    for k, (rung, pair) in enumerate(zip(ladder, errors)):
        _label(axes, k, rung.status or "", pair, floor, relative)
    log_ticks(axes.yaxis)
    if relative:
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{100.0 * value:g} %"))
    axes.set_ylabel("relative error" if relative else "error")
    if any(held is not None for _, held in errors):
        handles = [Patch(fc="#c3ccd5", label="fitted records"), Patch(fc=MUTED, label="held-out records")]
        axes.legend(handles=handles, loc="upper right", ncols=2, borderaxespad=0.0)


def _label(
    axes: Axes, k: int, status: str, errors: tuple[float | None, float | None], floor: float, relative: bool
) -> None:
    """The errors above their bars; the status above the held-out error, or above the only one."""
    fit, held = errors
    beside: dict[str, Any] = {
        "textcoords": "offset points", "xytext": (0, 4), "ha": "center", "va": "bottom", "zorder": 6,
    }  # fmt: skip
    if fit is not None and held is not None:
        axes.annotate(error_words(fit, relative), (k - _HALF, max(fit, floor)), color=MUTED, fontsize=10.5, **beside)
    main = held if held is not None else fit
    if main is not None:
        axes.annotate(
            f"{literal(status)}\n{error_words(main, relative)}".lstrip(),
            (k + (_HALF if held is not None and fit is not None else 0.0), max(main, floor)),
            color=_COLOURS.get(status, INK), weight="bold", fontsize=12, linespacing=1.15, **beside,
        )  # fmt: skip


def _misfits(axes: Axes, ladder: Sequence[RungAnswer]) -> None:
    misfits = [(_at_least(rung.misfit_fit), _at_least(rung.misfit_validate)) for rung in ladder]
    known = [value for pair in misfits for value in pair if value is not None and math.isfinite(value)]
    axes.set_yscale("log")
    if known:
        axes.set_ylim(min(known) / 2.0, max([*known, 10.0 * min(known)]) * 2.0)
        if min(known) <= _LEAST_MISFIT:
            words = f"bars at the lower edge: {_LEAST_MISFIT:g} or less"
            axes.text(0.996, 0.86, words, transform=axes.transAxes, color=MUTED, fontsize=9, ha="right")
    _bars(axes, ladder, misfits, axes.get_ylim()[0])
    log_ticks(axes.yaxis)
    axes.set_ylabel("misfit")


def _at_least(misfit: float | None) -> float | None:
    return None if misfit is None else max(misfit, _LEAST_MISFIT)


def _bars(axes: Axes, ladder: Sequence[RungAnswer], pairs: Pairs, floor: float) -> None:
    """A pale bar for the fitted records and a full one for the held-out ones, in the colour of the status, from ``floor``."""
    for k, (rung, (fit, held)) in enumerate(zip(ladder, pairs)):
        colour = _COLOURS.get(rung.status or "", BEFORE)
        alone = fit is None or held is None
        for value, at, alpha in ((fit, -_HALF, 0.4), (held, _HALF, 1.0)):
            if value is not None and math.isfinite(value) and value > 0.0:
                place = k + (0.0 if alone else at)
                # The line keeps a bar of no height visible.
                axes.plot([place - _HALF, place + _HALF], [value, value], color=colour, lw=2.0, alpha=alpha, zorder=3)
                axes.bar(place, value - floor, 2.0 * _HALF, floor, color=colour, alpha=alpha, lw=0, zorder=2)
    axes.grid(axis="y", color=RULE, lw=0.5)
    axes.set_axisbelow(True)


def residue_plot(first: Sequence[Place], last: Sequence[Place]) -> Drawing | None:
    """A panel for each mode: its entries measured (circles) and with the models (crosses), in units of the mode's norm.

    ``None`` where the places are not entries of a modal record.

    Parameters
    ----------
    first, last : entries with the first and with the last model; ``last`` may be empty.
    """
    entries = sorted((one for one in first if one.mode), key=lambda one: (one.mode or 0, entry_words(one)))
    if not entries:
        return None
    modelled = [(models, colour) for models, colour in ((first, BEFORE), (last, AFTER)) if models]
    modes = sorted({one.mode or 0 for one in entries})
    with style():
        figure, grid = panels(1, len(modes), 3.6, left=0.75, bottom=0.95, sharey=True)
        for axes, mode in zip(grid[0], modes):
            own = [one for one in entries if one.mode == mode]
            axes.axhline(0.0, color=RULE, lw=0.7, zorder=0)
            axes.axvline(0.0, color=RULE, lw=0.7, zorder=0)
            for entry, offset in zip(own, _OFFSETS * len(own)):
                for models, colour in modelled:
                    _entry(axes, entry, models, colour)
                real, imaginary = entry.measured or (math.nan, math.nan)
                axes.plot(imaginary, real, "o", mec=INK, mfc="white", ms=7, zorder=3)
                axes.annotate(
                    literal(entry_words(entry)), (imaginary, real), xytext=offset, textcoords="offset points",
                    color=MUTED, fontsize=9.0,
                )  # fmt: skip
            axes.set_title(f"mode {mode}, {sum(own[0].band_hz or (math.nan,)) / 2:.1f} Hz")
            axes.set_xlabel("s part R₁ / |c|")
            axes.margins(0.18)
        grid[0][0].set_ylabel("constant part R₀ / (ω |c|)")
        handles = [Line2D([], [], marker="o", mec=INK, mfc="white", ls="none", label="measured")]
        handles += [
            Line2D([], [], marker="x", color=colour, ls="none", label=label)
            for (_, colour), label in zip(modelled, (FIRST_MODEL, "last model"))
        ]
        figure.legend(handles=handles, loc="lower center", ncols=3, borderaxespad=0.1)
        return Drawing(
            figure, "residues", "Residues of each mode at resonance in the complex plane, measured and modelled"
        )


def _entry(axes: Axes, entry: Place, models: Sequence[Place], colour: str) -> None:
    """A cross at the model's value of an entry and a line to it from the measured one."""
    for one in models:
        if one.mode == entry.mode and entry_words(one) == entry_words(entry) and one.model and entry.measured:
            ends = (entry.measured, one.model)
            axes.plot([end[1] for end in ends], [end[0] for end in ends], color=colour, lw=1.0, zorder=2)
            axes.plot(one.model[1], one.model[0], "x", color=colour, ms=7, mew=1.6, zorder=4)


def four_thetas_plot(ladder: Sequence[RungAnswer]) -> Drawing | None:
    """theta [deg] of the fit and the four thetas of the paper's route, for each model; ``None`` where there are none."""
    rungs = [rung for rung in ladder if rung.four_thetas_deg and rung.theta_deg]
    if not rungs:
        return None
    with style():
        figure, grid = panels(1, 1, 2.8, left=0.75, bottom=0.65, top=0.15)
        axes = grid[0][0]
        for k, rung in enumerate(rungs):
            _theta(axes, k - 0.25, rung.theta_deg or (None, None), color=ACCENT, marker="o", ms=8, lw=1.6, capsize=3)
            for j, (value, (_, marker)) in enumerate(zip((rung.four_thetas_deg or {}).values(), _FOUR)):
                _theta(axes, k + 0.07 * j, value, color=INK, mfc="white", marker=marker, ms=6, lw=0.8)
        axes.set_xticks(range(len(rungs)), [textwrap.fill(literal(rung_name(rung.effect)), 20) for rung in rungs])
        axes.set_xlim(-0.5, len(rungs) - 0.2)
        axes.set_ylabel("θ, deg")
        axes.grid(axis="y", color=RULE, lw=0.5)
        handles = [Line2D([], [], marker="o", color=ACCENT, ms=8, lw=1.6, label="fit")]
        handles += [
            Line2D([], [], marker=marker, mec=INK, mfc="white", ls="none", label=name) for name, marker in _FOUR
        ]
        axes.legend(handles=handles, loc="upper right", ncols=5, borderaxespad=0.0)
        low, high = axes.get_ylim()
        axes.set_ylim(low, high + 0.18 * (high - low))
        return Drawing(figure, "axes", "The four estimates of theta and the fit's, for every model of the ladder")


def _theta(axes: Axes, place: float, theta_deg: Measured, **mark: Any) -> None:
    value, sd = theta_deg
    if value is not None:
        axes.errorbar(place, value, sd or 0.0, zorder=3, **mark)
