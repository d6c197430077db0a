"""Fixed lines and offsets of a record, by linear least squares, and the noise that is left.

    y = a_0 [+ a_1 t] + sum_h (b_h cos 2 pi h f t + c_h sin 2 pi h f t) + noise

Shapes: y (N, S).  sigma is the standard deviation of the noise a sample and channel [V].
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from scipy.fft import irfft, rfft
from scipy.special import fdtrc

from ...arrays import FloatArray
from ..instrument import Adc

#: Below this many LSB of noise, silence does not exercise the converter.
_EXERCISED_LSB = 0.5


@lru_cache(maxsize=16)
def line_basis(samples: int, sample_rate_hz: float, line_hz: float | None, trend: bool) -> FloatArray:
    """Orthonormal basis (N, L) of offset, optional trend and the harmonics of ``line_hz`` below Nyquist."""
    t = np.arange(samples) / sample_rate_hz
    columns = [np.ones(samples)]
    if trend:
        columns.append(t - t.mean())
    if line_hz is not None:
        for h in range(1, int(np.ceil(sample_rate_hz / 2.0 / line_hz - 1e-9))):
            columns += [np.cos(2.0 * np.pi * h * line_hz * t), np.sin(2.0 * np.pi * h * line_hz * t)]
    basis, _ = np.linalg.qr(np.stack(columns, axis=1))
    basis.setflags(write=False)
    return basis


def lines_removed(samples: int, sample_rate_hz: float, line_hz: float | None) -> int:
    """Degrees of freedom a channel that :func:`without_lines` takes."""
    return 1 if line_hz is None else 1 + 2 * (math.ceil(sample_rate_hz / 2.0 / line_hz - 1e-9) - 1)


def without_lines(y: FloatArray, sample_rate_hz: float, line_hz: float | None) -> FloatArray:
    """y (N, S) less its offset and the harmonics of ``line_hz``, by least squares."""
    samples = y.shape[0]
    cycles = None if line_hz is None else samples * line_hz / sample_rate_hz
    if cycles is not None and abs(cycles - round(cycles)) < 1e-9:
        # Lines on bins are orthogonal: dropping the bins is the same least squares.
        spectrum = rfft(y, axis=0)
        spectrum[:: round(cycles)] = 0.0
        return np.asarray(irfft(spectrum, n=samples, axis=0))
    basis = line_basis(samples, sample_rate_hz, line_hz, False)
    return y - basis @ (basis.T @ y)


def silent_sigma(y: FloatArray, sample_rate_hz: float, line_hz: float | None, adc: Adc | None) -> FloatArray:
    """sigma (S,) of a silent record [V]; LSB^2/12 is added where silence does not exercise the converter."""
    samples = y.shape[0]
    trend = line_basis(samples, sample_rate_hz, None, True)
    rest = without_lines(y - trend @ (trend.T @ y), sample_rate_hz, line_hz)
    removed = 1 + lines_removed(samples, sample_rate_hz, line_hz)
    variance = np.sum(rest**2, axis=0) / max(samples - removed, 1)
    if adc is not None:
        quiet = variance < (_EXERCISED_LSB * adc.lsb_v) ** 2
        variance = np.where(quiet, variance + adc.lsb_v**2 / 12.0, variance)
    return np.sqrt(variance)


def hum_line(y: FloatArray, sample_rate_hz: float) -> float | None:
    """Mains frequency (50 or 60 Hz) whose harmonics stand out of a silent record (N, S), or ``None``.

    F-test of the line regressors against the rest, 0.1 % for each of the two families.
    """
    best: tuple[float, float] | None = None
    for line_hz in (50.0, 60.0):
        if sample_rate_hz / 2.0 <= line_hz or y.shape[0] < 2.0 * sample_rate_hz / line_hz:
            continue
        lines = line_basis(y.shape[0], sample_rate_hz, line_hz, True)
        plain = line_basis(y.shape[0], sample_rate_hz, None, True)
        without = y - plain @ (plain.T @ y)
        left = y - lines @ (lines.T @ y)
        more, rest = lines.shape[1] - plain.shape[1], y.shape[0] - lines.shape[1]
        if rest < 10 * more:
            continue
        fall = float(np.sum(without**2) - np.sum(left**2))
        ratio = (fall / more) / max(float(np.sum(left**2)) / rest, 1e-300)
        senses = y.shape[1]
        if fdtrc(more * senses, rest * senses, ratio) < 1e-3 and (best is None or ratio > best[1]):
            best = (line_hz, ratio)
    return None if best is None else best[0]
