"""Single frequencies that stand out of a whole record: hum, and any other line that nobody drove.

A line is a bin of the Fourier transforms of records (all channels together) that is improbable as noise of its neighbourhood's
level, away from the drive, from the resonances and their sums, where a narrow peak is an answer.

Shapes: N samples, S senses.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.fft import rfft

from ...arrays import FloatArray
from ...criticism.lines import beyond_neighbours
from ...criticism.problem import Spectrum
from ...criticism.tails import log_tail

#: Bins at zero and at Nyquist that the window spreads over.
_ENDS = 3
#: A peak is a line where noise makes as high a one in this share of the bins.
_IMPROBABLE = 1e-12
_MOST = 40
_MAINS = (50.0, 60.0)


def spectrum_of(residual: FloatArray, sample_rate_hz: float) -> Spectrum:
    """Energy by frequency of a whitened residual (N, S), summed over its channels."""
    samples, senses = residual.shape
    window = np.hanning(samples)
    # Windowed, so that a line between two bins is three bins wide and not all of them.
    chi2 = np.sum(np.abs(rfft(residual.T * window, axis=-1)) ** 2, axis=0) / (0.5 * np.sum(window**2))
    # Of both ends but one or two degrees of freedom are left.
    inside = slice(_ENDS, chi2.size - _ENDS)
    return Spectrum(np.arange(chi2.size)[inside] * sample_rate_hz / samples, chi2[inside], 2 * senses)


def pooled(spectra: Sequence[Spectrum]) -> list[Spectrum]:
    """The sums of those that share a grid of frequencies."""
    alike: dict[bytes, list[Spectrum]] = {}
    for one in spectra:
        alike.setdefault(one.frequency_hz.tobytes(), []).append(one)
    return [
        Spectrum(own[0].frequency_hz, np.sum([one.chi2 for one in own], axis=0), sum(one.dof for one in own))
        for own in alike.values()
    ]


def lines_in(spectrum: Spectrum, avoided_hz: Sequence[tuple[float, float]]) -> list[float]:
    """Frequencies [Hz], rising, of the lines in a spectrum, outside the bands ``avoided_hz``."""
    chi2, frequency = spectrum.chi2, spectrum.frequency_hz
    peak = log_tail(beyond_neighbours(spectrum), spectrum.dof) < np.log(_IMPROBABLE)
    peak[1:-1] &= (chi2[1:-1] >= chi2[:-2]) & (chi2[1:-1] >= chi2[2:])
    peak[0] = peak[-1] = False
    for low, high in avoided_hz:
        peak &= (frequency < low) | (frequency > high)
    found = np.flatnonzero(peak)
    found = found[np.argsort(-chi2[found])][:_MOST]
    width = float(frequency[1] - frequency[0])
    return sorted(float(frequency[k]) + _refined(chi2, int(k)) * width for k in found)


def _refined(power: FloatArray, k: int) -> float:
    """Vertex [bins from k] of the parabola through the logarithms of a peak and its neighbours."""
    a, b, c = np.log(power[k - 1 : k + 2] + 1e-300)
    bend = a - 2.0 * b + c
    return float(np.clip(0.5 * (a - c) / bend, -0.5, 0.5)) if bend < 0.0 else 0.0


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
