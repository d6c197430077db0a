"""Single frequencies that stand out of a whole record: hum, and any other line that nobody drove.

A line is a bin of the record's Fourier transform (all channels together) that is improbable as noise among all bins and
rises out of its neighbourhood, away from the drive, from the resonances and their sums, where a narrow peak is an answer.

Shapes: N samples, S senses.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.fft import rfft
from scipy.ndimage import median_filter

from pipeline.arrays import FloatArray

#: chi2 of a bin, per degree of freedom, below which it is no line, and how far it rises out of its neighbourhood.
_LEAST, _RISE = 16.0, 30.0
_NEIGHBOURS = 101
_MOST = 40
_MAINS = (50.0, 60.0)


def lines_in(residual: FloatArray, sample_rate_hz: float, avoided_hz: Sequence[tuple[float, float]]) -> list[float]:
    """Frequencies [Hz], rising, of the lines in a whitened residual (N, S), outside the bands ``avoided_hz``."""
    samples = residual.shape[0]
    window = np.hanning(samples)
    # Windowed, so that a line between two bins is three bins wide and not all of them.
    power = np.mean(np.abs(rfft(residual.T * window, axis=-1)) ** 2, axis=0) / (0.5 * np.sum(window**2)) / 2.0
    level = median_filter(power, size=min(_NEIGHBOURS, power.size), mode="nearest")
    frequency = np.arange(power.size) * sample_rate_hz / samples
    peak = (power > _LEAST) & (power > _RISE * level)
    peak[1:-1] &= (power[1:-1] >= power[:-2]) & (power[1:-1] >= power[2:])
    peak[:2] = peak[-2:] = False
    for low, high in avoided_hz:
        peak &= (frequency < low) | (frequency > high)
    found = np.flatnonzero(peak)
    found = found[np.argsort(-power[found])][:_MOST]
    return sorted(_refined(power, int(k)) * sample_rate_hz / samples for k in found)


def _refined(power: FloatArray, k: int) -> float:
    """Vertex [bins] of the parabola through the logarithms of a peak and its neighbours."""
    a, b, c = np.log(power[k - 1 : k + 2] + 1e-300)
    bend = a - 2.0 * b + c
    return k + (float(np.clip(0.5 * (a - c) / bend, -0.5, 0.5)) if bend < 0.0 else 0.0)


def merged(frequencies_hz: Sequence[float], resolution_hz: float) -> list[float]:
    """One frequency for those closer than the resolution; a harmonic of the mains where one is as close."""
    out: list[float] = []
    for f in sorted(frequencies_hz):
        named = next((k * m for m in _MAINS if abs(f - (k := round(f / m)) * m) <= resolution_hz and k > 0), f)
        if not out or named - out[-1] > resolution_hz:
            out.append(named)
    return out


def without_these(
    residual: FloatArray, sample_rate_hz: float, frequencies_hz: Sequence[float]
) -> tuple[FloatArray, FloatArray]:
    """The residual (N, S) less sinusoids of these frequencies, and the energy (lines, S) that each took, one after another."""
    samples = residual.shape[0]
    t = np.arange(samples) / sample_rate_hz
    left, taken = residual, np.zeros((len(frequencies_hz), residual.shape[1]))
    basis = np.zeros((samples, 0))
    for k, f in enumerate(frequencies_hz):
        pair = np.stack([np.cos(2.0 * np.pi * f * t), np.sin(2.0 * np.pi * f * t)], axis=1)
        pair, _ = np.linalg.qr(pair - basis @ (basis.T @ pair))
        basis = np.concatenate([basis, pair], axis=1)
        share = pair.T @ left
        left = left - pair @ share
        taken[k] = np.sum(share**2, axis=0)
    return left, taken
