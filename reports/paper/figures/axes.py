"""Estimates of theta: the four of the paper, their convergence with the order, and one step against two."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from pipeline.arrays import FloatArray

from ...html.style import ACCENT, COLOURS, INK, MUTED, RULE, TRUTH, WIDTH, Drawing, style
from ..content import OrderView, StepsView

_NAMES = ("u1", "v1", "u2", "v2")
_SHADES = (ACCENT, COLOURS["fail"], TRUTH)


def thetas(estimates: Mapping[str, FloatArray], name: str = "thetas") -> Drawing:
    """The four estimates of theta, source -> (4,) [deg], one row per estimate and one marker colour per source."""
    with style():
        figure = Figure(figsize=(WIDTH, 2.4), layout="constrained")
        axes = figure.subplots()
        markers = ("s", "o", "D", "^")
        marker_styles = ((INK, "none", 11.0), (ACCENT, ACCENT, 6.5), (COLOURS["fail"], COLOURS["fail"], 4.0))
        for (source, values), (edge, face, size) in zip(estimates.items(), marker_styles):
            for k, (value, marker) in enumerate(zip(values, markers)):
                axes.plot(
                    value,
                    3 - k,
                    marker=marker,
                    ms=size,
                    mec=edge,
                    mfc=face,
                    ls="none",
                    label=source if k == 0 else None,
                )
        axes.set_yticks([3, 2, 1, 0], [f"θ from {n}" for n in _NAMES])
        axes.set(xlabel="θ, deg", ylim=(-0.6, 3.6))
        axes.grid(axis="both", color=RULE, lw=0.5)
        axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
        return Drawing(figure, name, "The four estimates of theta: printed, from eq. (14), from a simulated record")


def orders(view: OrderView, name: str = "orders") -> Drawing:
    """Errors of theta [deg] and split [mHz], and in-band phase change [deg], against the ARX order, by window."""
    with style():
        figure = Figure(figsize=(WIDTH, 3.1), layout="constrained")
        panels = figure.subplots(1, 3)
        line_styles = (("o", "-"), ("D", (0, (4, 2))))
        for window, theta, split, phase, colour, (marker, dash) in zip(
            view.window_s, view.theta_deg, view.split_hz, view.phase_change_deg, _SHADES, line_styles, strict=False
        ):
            label = f"{window:g} s of data"
            error = np.sqrt(np.mean((theta - view.true_theta_deg) ** 2, axis=1))
            panels[0].plot(view.order, error, marker=marker, ls=dash, color=colour, ms=4, label=label)
            gap = 1e3 * np.abs(split - view.true_split_hz)
            panels[1].plot(view.order, gap, marker=marker, ls=dash, color=colour, ms=4)
            # The reference order has zero change, which a logarithmic axis cannot show.
            other = view.order < view.order[-1]
            panels[2].plot(view.order[other], phase[other], marker=marker, ls=dash, color=colour, ms=4)
        for axes, label in zip(
            panels, ("rms error of the four θ, deg", "error of the split, mHz", "phase change, deg")
        ):
            axes.set(xlabel="order", ylabel=label, yscale="log")
            axes.yaxis.set_minor_formatter(NullFormatter())
            axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 3.0)))
            axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
            axes.axvline(40, color=MUTED, lw=0.8, ls=(0, (1, 2)))
            axes.grid(color=RULE, lw=0.5)
        panels[0].legend(loc="best")
        return Drawing(figure, name, "Convergence with the order of the ARX model, for two and three seconds of data")


def steps(view: StepsView, name: str = "steps") -> Drawing:
    """|error of theta| [deg] against the split [Hz]: two-step route, its limit without noise, and the one-step fit."""
    with style():
        figure = Figure(figsize=(WIDTH, 3.6), layout="constrained")
        panels = figure.subplots(1, view.share.size, sharey=True, squeeze=False)[0]
        for axes, share, route, limit, fit, sd in zip(
            panels, view.share, view.route_deg, view.limit_deg, view.fit_deg, view.sd_deg, strict=True
        ):
            axes.plot(view.split_hz, sd, color=ACCENT, lw=1.0, label="one step, its own sd")
            axes.plot(view.split_hz, fit, "o", ms=4.5, color=ACCENT, label="one-step fit")
            if share > 0.0:
                axes.plot(view.split_hz, limit, color=COLOURS["fail"], lw=1.0, label="two-step route, no noise")
            axes.plot(view.split_hz, route, "x", ms=6, mew=1.3, color=COLOURS["fail"], label="two-step route")
            axes.set(xscale="log", yscale="log", xlabel="split, Hz", ylim=(1e-5, 90.0))
            axes.set_title(f"c12 = {share:g} √(c11 c22)")
            axes.set_xticks([0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 4.0], ["0.05", "0.1", "0.2", "0.5", "1", "2", "4"])
            axes.minorticks_off()
            axes.grid(color=RULE, lw=0.5)
        panels[0].set_ylabel("|error of θ|, deg")
        handles, labels = panels[-1].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=4)
        return Drawing(figure, name, "Error of theta of the two-step route and of the one-step fit against the split")
