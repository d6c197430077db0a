"""Poles and residues: measured against modelled residues in the complex plane, and the four thetas rung by rung."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

from matplotlib.lines import Line2D

from ...html.style import ACCENT, INK, MUTED, RULE, style, to_svg
from ...run.figures.states import AFTER, BEFORE
from .panels import panels, plain

_NAMES = ("u₁", "v₁", "u₂", "v₂")
#: Of the names of entries [points], so that neighbours keep apart.
_OFFSETS = ((9, 3), (9, -11), (-37, 3), (-37, -11))
_MARKERS = ("s", "o", "D", "^")


@dataclass(frozen=True)
class Entry:
    """One entry of one mode in units of the mode's norm: measured, modelled before and after (``None``: not refined)."""

    mode: int
    frequency_hz: float
    name: str
    measured: complex
    before: complex
    after: complex | None


@dataclass(frozen=True)
class AxesPoint:
    """The fit's theta with its sd, and the four of the route with theirs, on one rung [deg]."""

    label: str
    theta_deg: tuple[float, float]
    four_deg: Sequence[tuple[float, float]]


def residues(entries: Sequence[Entry], name: str = "residues") -> str:
    """One panel a mode: each entry measured (circle) and modelled (crosses), with lines to what the models miss."""
    modes = sorted({entry.mode for entry in entries})
    with style():
        figure, grid = panels(1, len(modes), 3.6, left=0.75, bottom=0.95, sharey=True)
        for axes, mode in zip(grid[0], modes):
            own = [entry for entry in entries if entry.mode == mode]
            axes.axhline(0.0, color=RULE, lw=0.7, zorder=0)
            axes.axvline(0.0, color=RULE, lw=0.7, zorder=0)
            for entry, offset in zip(own, _OFFSETS * len(own)):
                for model, colour in ((entry.before, BEFORE), (entry.after, AFTER)):
                    if model is None:
                        continue
                    ends = (entry.measured, model)
                    axes.plot([z.imag for z in ends], [z.real for z in ends], color=colour, lw=1.0, zorder=2)
                    axes.plot(model.imag, model.real, "x", color=colour, ms=7, mew=1.6, zorder=4)
                axes.plot(entry.measured.imag, entry.measured.real, "o", mec=INK, mfc="white", ms=7, zorder=3)
                axes.annotate(
                    plain(entry.name), (entry.measured.imag, entry.measured.real), xytext=offset,
                    textcoords="offset points", color=MUTED, fontsize=9.0,
                )  # fmt: skip
            axes.set_title(f"mode {mode}, {own[0].frequency_hz:.1f} Hz")
            axes.set_xlabel("s part R₁ / |c|")
            axes.margins(0.18)
        grid[0][0].set_ylabel("constant part R₀ / (ω |c|)")
        shown = [Line2D([], [], marker="o", mec=INK, mfc="white", ls="none", label="measured")]
        shown.append(Line2D([], [], marker="x", color=BEFORE, ls="none", label="model as given"))
        if any(entry.after is not None for entry in entries):
            shown.append(Line2D([], [], marker="x", color=AFTER, ls="none", label="with the effects added"))
        figure.legend(handles=shown, loc="lower center", ncols=3, borderaxespad=0.1)
        return to_svg(figure, name, "Residues of each mode at resonance in the complex plane, measured and modelled")


def axes_by_rung(points: Sequence[AxesPoint], name: str = "axes") -> str:
    """The four thetas of each rung, their effects taken out, beside the fit's theta."""
    with style():
        figure, grid = panels(1, 1, 2.8, left=0.75, bottom=0.65, top=0.15)
        axes = grid[0][0]
        for k, point in enumerate(points):
            theta, sd = point.theta_deg
            axes.errorbar(k - 0.25, theta, sd, color=ACCENT, marker="o", ms=8, lw=1.6, capsize=3, zorder=4)
            for j, (value, own) in enumerate(point.four_deg):
                axes.errorbar(
                    k + 0.07 * j, value, own, color=INK, mfc="white", marker=_MARKERS[j], ms=6, lw=0.8, zorder=3
                )
        axes.set_xticks(range(len(points)), [textwrap.fill(plain(point.label), 20) for point in points])
        axes.set_xlim(-0.5, len(points) - 0.2)
        axes.set_ylabel("θ, deg")
        axes.grid(axis="y", color=RULE, lw=0.5)
        handles = [Line2D([], [], marker="o", color=ACCENT, ms=8, lw=1.6, label="fit")]
        handles += [
            Line2D([], [], marker=mark, mec=INK, mfc="white", ls="none", label=name_)
            for mark, name_ in zip(_MARKERS, _NAMES)
        ]
        axes.legend(handles=handles, loc="upper right", ncols=5, borderaxespad=0.0)
        low, high = axes.get_ylim()
        axes.set_ylim(low, high + 0.18 * (high - low))
        return to_svg(figure, name, "The four estimates of theta and the fit's, on every rung of the ladder")
