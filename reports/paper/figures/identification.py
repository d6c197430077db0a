"""Figures 4, 5 and 6 of the paper and the Hankel singular values, redrawn."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from pipeline.arrays import FloatArray

from ...html.style import ACCENT, COLOURS, MUTED, RULE, TRUTH, WIDTH, Drawing, style
from ..content import HankelView, PaperRecord, ResponseView

_CHANNELS = (("S1/D1", 0, 0), ("S1/D2", 0, 1), ("S2/D1", 1, 0), ("S2/D2", 1, 1))
_LINE_STYLES = (
    {"color": MUTED, "lw": 3.2, "alpha": 0.45},
    {"color": COLOURS["fail"], "lw": 1.4, "ls": (0, (5, 3))},
    {"color": ACCENT, "lw": 1.1},
    {"color": TRUTH, "lw": 1.3, "ls": (0, (1, 2))},
)
_COLUMNS = 700


def _envelope(time_s: FloatArray, volts: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Time, minimum and maximum of as many segments as the figure has pixel columns."""
    size = max(1, volts.size // _COLUMNS)
    count = volts.size // size
    pieces = volts[: count * size].reshape(count, size)
    return time_s[: count * size : size], pieces.min(axis=1), pieces.max(axis=1)


def records(view: PaperRecord, name: str = "figure-4") -> Drawing:
    """Sense records [V] and their power spectral density [V^2/Hz], with resonances, their harmonics and hum marked."""
    with style():
        figure = Figure(figsize=(WIDTH, 5.2), layout="constrained")
        panels = figure.subplots(2, 2, width_ratios=(1.0, 1.35))
        for k in (0, 1):
            time, spectrum = panels[k]
            t, low, high = _envelope(view.time_s, view.sense_v[:, k])
            time.fill_between(t, low, high, color=ACCENT, lw=0.3)
            time.set(xlim=(0.0, view.time_s[-1]), ylabel=f"S{k + 1}, V")
            level = 10.0 * np.log10(np.maximum(view.psd[:, k], 1e-300))
            spectrum.plot(view.frequency_hz, level, color=ACCENT, lw=0.8)
            shown = view.frequency_hz <= 2000.0
            floor, top = float(level[shown][1:].min()) - 4.0, float(level[shown].max()) + 18.0
            spectrum.set(xlim=(0.0, 2000.0), ylim=(floor, top), ylabel="PSD, dB re 1 V²/Hz")
            for harmonic, text in ((1, "modes"), (2, "2nd harmonic"), (3, "3rd")):
                first, last = (harmonic * f for f in view.resonance_hz)
                spectrum.axvspan(first - 25.0, last + 25.0, color=RULE, alpha=0.55, lw=0, zorder=0)
                spectrum.text((first + last) / 2.0, top - 3.0, text, ha="center", va="top", fontsize=9.5)
            lines = view.line_hz * np.arange(1, 10)
            spectrum.plot(lines, np.full(lines.size, floor + 2.0), ls="none", marker="^", ms=4.5, color=COLOURS["fail"])
            spectrum.grid(color=RULE, lw=0.5)
        panels[1, 0].set_xlabel("time, s")
        panels[1, 1].set_xlabel(f"frequency, Hz    (▲ multiples of {view.line_hz:g} Hz)")
        return Drawing(figure, name, "Sense records over three seconds and their power spectral densities")


def broadband(view: ResponseView, name: str = "figure-5") -> Drawing:
    """Magnitude of the order-40 model over the whole band, four channels."""
    with style():
        figure = Figure(figsize=(WIDTH, 4.6), layout="constrained")
        panels = figure.subplots(2, 2, sharex=True, sharey=True)
        for (label, s, d), axes in zip(_CHANNELS, panels.ravel(), strict=True):
            axes.semilogx(view.wide_hz, 20.0 * np.log10(np.abs(view.wide[:, s, d])), color=ACCENT, lw=1.0)
            axes.axvspan(400.0, 700.0, color=RULE, alpha=0.5, lw=0, zorder=0)
            axes.set_title(label)
            axes.grid(color=RULE, lw=0.5)
            axes.set_xlim(view.wide_hz[0], view.wide_hz[-1])
            axes.set_xticks(
                [100, 200, 400, 700, 1000, 2000, 5000], ["100", "200", "400", "700", "1000", "2000", "5000"]
            )
            axes.minorticks_off()
        for axes in panels[:, 0]:
            axes.set_ylabel("gain, dB")
        for axes in panels[1]:
            axes.set_xlabel("frequency, Hz    (shaded: swept band)")
        return Drawing(figure, name, "Broad-band frequency response of the order-40 model, four channels")


def zoomed(view: ResponseView, name: str = "figure-6") -> Drawing:
    """Magnitude and phase around the rocking modes and around the up-down mode: order 40, six states by two methods, eq. (14)."""
    gap = int(np.argmax(np.diff(view.narrow_hz))) + 1
    parts = (slice(0, gap), slice(gap, None))
    with style():
        figure = Figure(figsize=(WIDTH, 7.4), layout="constrained")
        panels = figure.subplots(4, 4, sharey="row", height_ratios=(1.6, 1.0, 1.6, 1.0), width_ratios=(1.6, 1.0) * 2)
        for k, (label, s, d) in enumerate(_CHANNELS):
            for j, part in enumerate(parts):
                gain, phase = panels[2 * (k // 2) : 2 * (k // 2) + 2, 2 * (k % 2) + j]
                f = view.narrow_hz[part]
                for (model, response), line_style in zip(view.narrow.items(), _LINE_STYLES, strict=True):
                    h = response[part, s, d]
                    gain.plot(f, 20.0 * np.log10(np.abs(h)), label=model, **line_style)
                    # The branch is fixed at the left edge, the same for all models.
                    phase_deg = np.rad2deg(np.unwrap(np.angle(h)))
                    phase.plot(f, phase_deg - 360.0 * np.round((phase_deg[0] + 130.0 * (1 + j)) / 360.0), **line_style)
                if j == 0:
                    gain.set_title(label)
                for axes in (gain, phase):
                    axes.grid(color=RULE, lw=0.5)
                    axes.set_xlim(f[0], f[-1])
        for row, text in enumerate(("gain, dB", "phase, deg") * 2):
            panels[row, 0].set_ylabel(text)
        for axes in panels[3]:
            axes.set_xlabel("frequency, Hz")
        handles, labels = panels[0, 0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=4)
        return Drawing(figure, name, "Frequency response around the modes: order 40, six states, printed model")


def hankel(view: HankelView, shown: int = 24, name: str = "hankel") -> Drawing:
    """Hankel singular values, the first ``shown``: of the order-40 model of the record, of eq. (14), and as printed."""
    with style():
        figure = Figure(figsize=(WIDTH, 3.0), layout="constrained")
        axes = figure.subplots()
        count = min(shown, view.model.size)
        axes.semilogy(
            np.arange(1, count + 1), view.model[:count], "o", ms=5, color=ACCENT, label="order 40, this record"
        )
        axes.semilogy(np.arange(1, 7), view.eq14[:6], "+", ms=11, mew=1.6, color=COLOURS["fail"], label="eq. (14)")
        axes.semilogy(
            np.arange(1, view.printed.size + 1), view.printed, "x", ms=7, mew=1.4, color=TRUTH, label="printed"
        )
        axes.axvline(6.5, color=MUTED, lw=0.8, ls=(0, (4, 3)))
        axes.text(6.6, 0.97, "six states kept", transform=axes.get_xaxis_transform(), va="top", fontsize=9.5)
        axes.set(xlabel="number", ylabel="Hankel singular value", xlim=(0.4, count + 0.6))
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.grid(color=RULE, lw=0.5)
        axes.legend(loc="upper right")
        return Drawing(figure, name, "Hankel singular values")
