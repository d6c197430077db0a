"""Spectral lines: single frequencies whose energy exceeds the noise of their neighbourhood.

    q_k = chi2_k / max(1, median over the neighbours of chi2 / median of chi2_d)        ~ chi2_d under noise alone

Coloured or underestimated noise raises the neighbours as well and leaves q unchanged; a line raises only its own bin.
Shapes: M bins.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import median_filter
from scipy.special import chdtri

from ..arrays import FloatArray
from .problem import Spectrum
from .significance import log_tail

_NEIGHBOURS = 101
#: A peak is a line if noise exceeds it with at most this probability per bin.
_IMPROBABLE = 1e-12
_MOST = 40


def normalized_energy(spectrum: Spectrum) -> FloatArray:
    """q_k (M,): energies in units of the background level of their neighbourhood, or of the noise if that is higher."""
    size = min(_NEIGHBOURS, spectrum.chi2.size)
    background = median_filter(spectrum.chi2, size=size, mode="reflect") / chdtri(spectrum.dof, 0.5)
    return np.asarray(spectrum.chi2 / np.maximum(background, 1.0))


def lines_in(spectrum: Spectrum, excluded_hz: Sequence[tuple[float, float]]) -> list[float]:
    """Frequencies [Hz] of the lines of a spectrum, ascending, outside the bands ``excluded_hz`` [Hz]."""
    chi2, frequency = spectrum.chi2, spectrum.frequency_hz
    peak = log_tail(normalized_energy(spectrum), spectrum.dof) < np.log(_IMPROBABLE)
    peak[1:-1] &= (chi2[1:-1] >= chi2[:-2]) & (chi2[1:-1] >= chi2[2:])
    peak[0] = peak[-1] = False
    for low, high in excluded_hz:
        peak &= (frequency < low) | (frequency > high)
    found = np.flatnonzero(peak)
    found = found[np.argsort(-chi2[found])][:_MOST]
    width = float(frequency[1] - frequency[0])
    return sorted(float(frequency[k]) + _interpolated(chi2, int(k)) * width for k in found)


def pooled_spectra(spectra: Sequence[Spectrum]) -> list[Spectrum]:
    """One spectrum per frequency grid: the sum of those that share it."""
    by_grid: dict[bytes, list[Spectrum]] = {}
    for one in spectra:
        by_grid.setdefault(one.frequency_hz.tobytes(), []).append(one)
    return [
        Spectrum(own[0].frequency_hz, np.sum([one.chi2 for one in own], axis=0), sum(one.dof for one in own))
        for own in by_grid.values()
    ]


def _interpolated(energy: FloatArray, k: int) -> float:
    """Vertex [bins from k] of the parabola through the logarithms of peak ``k`` and its two neighbours."""
    a, b, c = np.log(energy[k - 1 : k + 2] + 1e-300)
    curvature = a - 2.0 * b + c
    return float(np.clip(0.5 * (a - c) / curvature, -0.5, 0.5)) if curvature < 0.0 else 0.0
