"""Offset, trend and mains lines of a record by linear least squares, and the noise that remains.

    y = a_0 [+ a_1 t] + sum_h (b_h cos 2 pi h f t + c_h sin 2 pi h f t) + noise

Shapes: y (N, S) [V] with N samples and S senses, L regressors.  sigma is the standard deviation of the noise per sample and
channel [V].
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from scipy.fft import irfft, rfft
from scipy.special import fdtrc

from ...arrays import FloatArray
from ..instrument import Adc
from .long_lines import long_fit

#: Noise below this many LSB does not exercise the ADC in silence.
_EXERCISED_LSB = 0.5
#: Highest harmonic of the mains that is looked for: rectifiers emit up to some kHz.  A record at 280 kHz has 2,800 below Nyquist,
#: whose basis alone takes 50 s.
MOST_HARMONICS = 100
#: Longest record whose regressors are a matrix [samples]: 200 columns take 52 MB, four times that while they are made, and
#: the matrices of 50 and 60 Hz are kept.  For 80 s of silence at 10 kHz each takes 1.3 GB and minutes.
_LONGEST_BASIS = 2**15


def harmonic_count(sample_rate_hz: float, line_hz: float) -> int:
    """Number of harmonics of ``line_hz`` [Hz] below Nyquist that are looked for."""
    return min(math.ceil(sample_rate_hz / 2.0 / line_hz - 1e-9) - 1, MOST_HARMONICS)


@lru_cache(maxsize=16)
def line_basis(samples: int, sample_rate_hz: float, line_hz: float | None, trend: bool) -> FloatArray:
    """Orthonormal basis (N, L) of offset, optional trend, and the harmonics of ``line_hz`` [Hz]; read-only."""
    t = np.arange(samples) / sample_rate_hz
    columns = [np.ones(samples)]
    if trend:
        columns.append(t - t.mean())
    if line_hz is not None:
        for h in range(1, harmonic_count(sample_rate_hz, line_hz) + 1):
            columns += [np.cos(2.0 * np.pi * h * line_hz * t), np.sin(2.0 * np.pi * h * line_hz * t)]
    basis, _ = np.linalg.qr(np.stack(columns, axis=1))
    basis.setflags(write=False)
    return basis


def regressors(sample_rate_hz: float, line_hz: float | None, trend: bool) -> int:
    """Number of offset, optional trend, and waves of the harmonics of ``line_hz`` [Hz]."""
    return 1 + int(trend) + (0 if line_hz is None else 2 * harmonic_count(sample_rate_hz, line_hz))


def fitted_lines(y: FloatArray, sample_rate_hz: float, line_hz: float | None, trend: bool) -> FloatArray:
    """Offset, optional trend and harmonics of ``line_hz`` [Hz] (N, S) of y (N, S), by least squares."""
    if y.shape[0] > _LONGEST_BASIS:
        count = 0 if line_hz is None else harmonic_count(sample_rate_hz, line_hz)
        return long_fit(y, 2.0 * np.pi * (line_hz or 0.0) / sample_rate_hz, count, trend)
    basis = line_basis(y.shape[0], sample_rate_hz, line_hz, trend)
    return np.asarray(basis @ (basis.T @ y))


def lines_removed(samples: int, sample_rate_hz: float, line_hz: float | None) -> int:
    """Degrees of freedom per channel that :func:`without_lines` removes; ``sample_rate_hz``, ``line_hz`` [Hz]."""
    return 1 if line_hz is None else 1 + 2 * harmonic_count(sample_rate_hz, line_hz)


def without_lines(y: FloatArray, sample_rate_hz: float, line_hz: float | None) -> FloatArray:
    """y (N, S) without its offset and the harmonics of ``line_hz`` [Hz], by least squares."""
    samples = y.shape[0]
    cycles = None if line_hz is None else samples * line_hz / sample_rate_hz
    if cycles is not None and abs(cycles - round(cycles)) < 1e-9:
        # Lines that fall on bins are orthogonal, so their bins are the least-squares solution.  They are those of the mean of
        # the parts of a record within which all lines have whole periods.
        parts = math.gcd(samples, round(cycles))
        folded = y.reshape(parts, samples // parts, -1)
        spectrum = rfft(folded.mean(axis=0), axis=0)
        bins = slice(0, MOST_HARMONICS * round(cycles) // parts + 1, round(cycles) // parts)
        lines = np.zeros_like(spectrum)
        lines[bins] = spectrum[bins]
        return np.asarray((folded - irfft(lines, n=samples // parts, axis=0)).reshape(y.shape))
    return y - fitted_lines(y, sample_rate_hz, line_hz, False)


def with_quantisation(variance: FloatArray, adc: Adc | None) -> FloatArray:
    """``variance`` (S,) [V^2] plus LSB^2/12 where silence does not exercise the ADC, which a driven record does."""
    if adc is None:
        return variance
    quiet = variance < (_EXERCISED_LSB * adc.lsb_v) ** 2
    return np.where(quiet, variance + adc.lsb_v**2 / 12.0, variance)


def silent_residual(y: FloatArray, sample_rate_hz: float, line_hz: float | None) -> tuple[FloatArray, FloatArray]:
    """A silent record y (N, S) [V] without offset, trend and lines, (N, S), and its variance (S,) [V^2]."""
    samples = y.shape[0]
    residual = without_lines(y - fitted_lines(y, sample_rate_hz, None, True), sample_rate_hz, line_hz)
    return residual, np.vecdot(residual.T, residual.T) / silent_dof(samples, sample_rate_hz, line_hz)


def silent_dof(samples: int, sample_rate_hz: float, line_hz: float | None) -> int:
    """Degrees of freedom per channel of :func:`silent_residual`; ``sample_rate_hz``, ``line_hz`` [Hz]."""
    return max(samples - 1 - lines_removed(samples, sample_rate_hz, line_hz), 1)


def silent_sigma(y: FloatArray, sample_rate_hz: float, line_hz: float | None, adc: Adc | None) -> FloatArray:
    """sigma (S,) [V] of a silent record y (N, S); LSB^2/12 is added where silence does not exercise the ADC."""
    _, variance = silent_residual(y, sample_rate_hz, line_hz)
    return np.sqrt(with_quantisation(variance, adc))


def hum_line(y: FloatArray, sample_rate_hz: float) -> float | None:
    """Mains frequency, 50 or 60 [Hz], with significant harmonics in a silent record (N, S) [V], or ``None``.

    F-test of the harmonics against the residual, at 0.1 % for each of the two frequencies.
    """
    best: tuple[float, float] | None = None
    for line_hz in (50.0, 60.0):
        if sample_rate_hz / 2.0 <= line_hz or y.shape[0] < 2.0 * sample_rate_hz / line_hz:
            continue
        count, dof = 2 * harmonic_count(sample_rate_hz, line_hz), y.shape[0] - regressors(sample_rate_hz, line_hz, True)
        if dof < 10 * count:
            continue
        without_harmonics = y - fitted_lines(y, sample_rate_hz, None, True)
        residual = y - fitted_lines(y, sample_rate_hz, line_hz, True)
        explained = float(np.sum(without_harmonics**2) - np.sum(residual**2))
        ratio = (explained / count) / max(float(np.sum(residual**2)) / dof, 1e-300)
        senses = y.shape[1]
        if fdtrc(count * senses, dof * senses, ratio) < 1e-3 and (best is None or ratio > best[1]):
            best = (line_hz, ratio)
    return None if best is None else best[0]
