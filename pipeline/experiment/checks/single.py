"""Lag of a device with one drive, from the phase of its frequency response on both sides of a resonance.

    arg H(f) = base - 2 pi f tau - zeta g(f/f_0) - (pi above f_0),   g(r) = 2 r / (1 - r^2)

base is 0 or pi for a displacement pick-off and +-pi/2 for a velocity pick-off, so twice the phase is known modulo 2 pi.
H = S_yu / S_uu by Welch's method, divided by the declared hold and filter; the weights follow from the coherence (Bendat and
Piersol, Random Data, ch. 9).  Frequencies in hertz, lags in samples.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.fft import rfft

from ...arrays import ComplexArray, FloatArray
from ..antialias import filter_response
from ..instrument import Instrument
from ..record import Record
from .wiring import hold_factor

_MAX_LAG = 60.0
#: Windows that are transformed at once: 256 kB of samples each.
_AT_ONCE = 64
_STEP = 0.1
#: Relative distance from the resonance within which damping and nonlinearity dominate the phase.
_NEAR = 0.1
#: Smallest weighted mean of cos(phase error) (1 is perfect) at which the lag counts as measured.
_AGREEMENT = 0.9
#: Lags of two records that differ by less [samples] are equal, as those that are too small to be reported.
_SAME = 0.1


def _averaged(
    u: FloatArray, y: FloatArray, rate_hz: float, segment: int
) -> tuple[FloatArray, FloatArray, ComplexArray, FloatArray]:
    """Frequencies [Hz], S_uu, S_uy and coherence of u and y (N,), over half overlapping Hann windows of ``segment`` samples."""
    window: FloatArray = np.hanning(segment + 1)[:-1].astype(np.float64)
    starts = range(0, u.size - segment + 1, segment - segment // 2)
    uu: FloatArray = np.zeros(segment // 2 + 1)
    yy: FloatArray = np.zeros(segment // 2 + 1)
    uy = np.zeros(segment // 2 + 1, dtype=np.complex128)
    for at in range(0, len(starts), _AT_ONCE):
        rows = list(starts[at : at + _AT_ONCE])
        U, Y = (
            rfft((part - part.mean(axis=1, keepdims=True)) * window)
            for part in (sliding_window_view(u, segment)[rows], sliding_window_view(y, segment)[rows])
        )
        uu += np.sum(np.abs(U) ** 2, axis=0)
        yy += np.sum(np.abs(Y) ** 2, axis=0)
        uy += np.sum(np.conj(U) * Y, axis=0)
    coherent = np.asarray(np.abs(uy) ** 2 / np.maximum(uu * yy, np.finfo(float).tiny), dtype=np.float64)
    frequencies = np.fft.rfftfreq(segment, 1.0 / rate_hz).astype(np.float64)
    return frequencies, uu, uy, coherent


def common_lag(records: Sequence[Record], sense: int, instrument: Instrument) -> tuple[float, float] | None:
    """The most precise ``single_lag`` of the records; ``None`` where no record shows one, or two of them differ.

    Between several resonances the phase turns as with a lag, but by another amount in each band.
    """
    found = [lag for record in records if (lag := single_lag(record, sense, instrument)) is not None]
    best = min(found, key=lambda one: one[1], default=None)
    if best is None or any(abs(lag - best[0]) > _SAME + 5.0 * math.hypot(sd, best[1]) for lag, sd in found):
        return None
    return best


def single_lag(record: Record, sense: int, instrument: Instrument) -> tuple[float, float] | None:
    """Lag and its sd [samples] of ``sense`` (counted from 0) behind the only drive.

    ``None`` where the drive is constant, fewer than 8 frequencies are driven and coherent, or their phases fit no lag.
    """
    u, y = record.drive_v[:, 0], record.sense_v[:, sense]
    segment = min(2048, u.size // 8)
    if segment < 64 or not np.any(u != u[0]):
        return None
    rate = record.sample_rate_hz
    f, power, cross, coherent = _averaged(u, y, rate, segment)
    driven = (power > 1e-3 * power.max()) & (f > 0.0) & (f < 0.45 * rate) & (coherent > 0.5)
    if np.sum(driven) < 8:
        return None
    H = cross[driven] / power[driven]
    f, coherent = f[driven], np.minimum(coherent[driven], 0.9999)
    known = np.array([hold_factor(2j * math.pi * hz, rate, instrument.hold) for hz in f])
    H = H / (known * filter_response(instrument.antialias, 2j * np.pi * f))
    peak = float(f[np.argmax(np.abs(H))])
    away = np.abs(f / peak - 1.0) > _NEAR
    if np.sum(away) < 8:
        return None
    f, phase, weight = f[away], np.angle(H[away]), (coherent / (1.0 - coherent))[away]
    weight = np.minimum(weight, 100.0 * np.median(weight))
    lags = np.arange(-_MAX_LAG, _MAX_LAG, _STEP)
    phasors = np.exp(2j * (phase[None, :] + 2.0 * np.pi * f * lags[:, None] / rate))
    score = np.abs(np.real(phasors @ weight)) / np.sum(weight)
    best = float(lags[np.argmax(score)])
    if score.max() < _AGREEMENT:
        return None
    # Near the best lag the phase is linear in the rest of the lag and in the damping.
    residual = phase + 2.0 * np.pi * f * best / rate
    base = 0.5 * float(np.angle(np.sum(weight * np.exp(2j * residual)).real + 0j))
    residual = np.angle(np.exp(2j * (residual - base))) / 2.0
    ratio = f / peak
    design = np.stack([-2.0 * np.pi * f / rate, -2.0 * ratio / (1.0 - ratio**2)], axis=1)
    root = np.sqrt(weight)[:, None]
    solution = np.linalg.lstsq(design * root, residual * root[:, 0], rcond=None)[0]
    error = (residual - design @ solution) * root[:, 0]
    covariance = np.linalg.inv((design * root).T @ (design * root)) * np.sum(error**2) / max(f.size - 2, 1)
    return best + float(solution[0]), float(np.sqrt(covariance[0, 0]))
