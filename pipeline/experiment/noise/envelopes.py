"""Noise of amplitude, phase and frequency against time, from neighbouring rows less a local fit, without a model of the device.

    var A   = s^2 g(a/s) + (r a)^2          g: Rician, 1 far above the floor (``envelopes.amplitude_sd``); r: noise of a gain
    var phi = (s/a)^2 + r^2                 likewise of a frequency, with an s of its own

v of a window of W rows is the residual power of a polynomial of second order per free row; v over its mean is a gamma variable of
shape (W - 3)/2.  s^2 and r^2 >= 0 solve v ~ s^2 x + r^2 y with weights 1/v^2 of the last solution.

Shapes: N rows, S senses, K windows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import gammainccinv

from ...arrays import FloatArray
from ...errors import MeasurementError
from ..envelopes import EnvelopeRecord, amplitude_sd

_WIDTH, _ORDER = 8, 3
#: Fewest windows, iterations of the weights, tail probability of a window that is left out.
_FEWEST, _ROUNDS, _TAIL = 5, 8, 1e-3
#: a/s below which a phase is lost.
_CLEAR = 5.0
#: Smallest noise of an amplitude, relative to the largest: six digits of a file.
_ROUNDED = 1e-6


@dataclass(frozen=True, eq=False)
class EnvelopeNoise:
    """sd of each value of a record.

    Parameters
    ----------
    amplitude_v : (N, S) [V]; phase_rad : (N, S) [rad], infinite where the phase is lost; frequency_hz : (N,) [Hz] likewise.
    floor_v : (S,) noise far above the floor [V].
    declared : whether the record states it.
    windows : number of windows that measure it.
    """

    amplitude_v: FloatArray
    phase_rad: FloatArray | None
    frequency_hz: FloatArray | None
    floor_v: FloatArray
    declared: bool
    windows: int


def envelope_noise(record: EnvelopeRecord) -> EnvelopeNoise:
    """The noise of a record.

    Raises
    ------
    MeasurementError : too few rows, or a channel without noise.
    """
    senses = record.amplitude_v.shape[1]
    if record.time_s.size < _FEWEST * _WIDTH:
        raise MeasurementError(
            f"{record.name}: too few rows for the noise level",
            value=record.time_s.size,
            allowed=f"at least {_FEWEST * _WIDTH} rows, behind the transient of the filter and as far apart as it allows",
            next_step="record the decay longer or more often; correct time_constant_s",
        )
    found, floors = [], []
    for k in range(senses):
        a = record.amplitude_v[:, k]
        if record.sd_v is not None:
            found.append(record.sd_v[:, k])
            floors.append(float(np.median(record.sd_v[:, k])))
            continue
        sd, floor = _amplitude(record, a)
        found.append(sd)
        floors.append(floor * np.sqrt(record.averages))
    floor_v, amplitude = np.array(floors), np.stack(found, axis=1)
    if not np.all(amplitude > 0.0):
        raise MeasurementError(
            f"{record.name}: an amplitude has no noise",
            allowed="an sd above 0 in every row",
            next_step="declare sense<k>_sd_V under [columns]",
        )
    smooth = np.sqrt(np.maximum(record.amplitude_v**2 - 2.0 * floor_v**2, 0.0))
    clear = np.minimum.accumulate(smooth > _CLEAR * floor_v, axis=0)
    phase = frequency = None
    if record.phase_rad is not None:
        pairs = zip(record.phase_rad.T, smooth.T, clear.T)
        phase = np.stack([_angle(record.time_s, phi, a, seen) for phi, a, seen in pairs], axis=1)
    if record.frequency_hz is not None:
        frequency = _angle(record.time_s, record.frequency_hz, smooth[:, 0], clear[:, 0])
    return EnvelopeNoise(amplitude, phase, frequency, floor_v, record.sd_v is not None, record.time_s.size // _WIDTH)


def _windows(t: FloatArray, y: FloatArray) -> FloatArray:
    """v (K,) of the windows of y (N,)."""
    out = []
    for first in range(0, t.size - _WIDTH + 1, _WIDTH):
        x = t[first : first + _WIDTH]
        x = 2.0 * (x - x[0]) / (x[-1] - x[0]) - 1.0
        basis = np.linalg.qr(np.stack([np.ones_like(x), x, x**2], axis=1))[0]
        own = y[first : first + _WIDTH]
        out.append(float(np.sum((own - basis @ (basis.T @ own)) ** 2)) / (_WIDTH - _ORDER))
    return np.array(out)


def _mean(values: FloatArray) -> FloatArray:
    count = values.size // _WIDTH
    return np.asarray(values[: count * _WIDTH].reshape(count, _WIDTH).mean(axis=1))


def _two(v: FloatArray, x: FloatArray, y: FloatArray) -> tuple[float, float]:
    """s^2 and r^2 of v ~ s^2 x + r^2 y (K,)."""
    from scipy.optimize import nnls

    most = float(gammainccinv((_WIDTH - _ORDER) / 2.0, _TAIL) / ((_WIDTH - _ORDER) / 2.0))
    model, kept = np.maximum(v, 1e-12 * float(v.max()) + 1e-300), np.ones(v.size, dtype=bool)
    found = np.zeros(2)
    for _ in range(_ROUNDS):
        scale = np.array([x[kept].max(), y[kept].max()]) + 1e-300
        columns = np.stack([x / scale[0], y / scale[1]], axis=1) / model[:, None]
        found = nnls(columns[kept], (v / model)[kept])[0] / scale
        model = np.maximum(found[0] * x + found[1] * y, 1e-9 * float(np.median(v)) + 1e-300)
        kept = v < most * model
        if np.count_nonzero(kept) < _FEWEST:
            kept = np.ones(v.size, dtype=bool)
    return float(found[0]), float(found[1])


def _amplitude(record: EnvelopeRecord, a: FloatArray) -> tuple[FloatArray, float]:
    """sd (N,) [V] of amplitudes a (N,), and the floor [V] divided by the root of the averages."""
    v, level = _windows(record.time_s, a), _mean(a)
    # A computed decay has no floor; its noise is the rounding of its amplitudes.
    least = _ROUNDED * float(a.max())
    floor, n = max(float(np.sqrt(np.median(v))), least), record.averages
    r2 = 0.0
    for _ in range(3):
        own = np.sqrt(n) * floor
        s2, r2 = _two(v, amplitude_sd(_true(level, own), own, n) ** 2 / floor**2, level**2)
        floor = max(float(np.sqrt(s2)), least)
    own = np.sqrt(n) * floor
    smooth = _true(_smoothed(a), own)
    return np.sqrt(amplitude_sd(smooth, own, n) ** 2 + r2 * smooth**2), floor


def _true(a: FloatArray, floor: float) -> FloatArray:
    return np.sqrt(np.maximum(a**2 - 2.0 * floor**2, 0.0))


def _smoothed(a: FloatArray) -> FloatArray:
    """Mean of the neighbours (N,)."""
    padded = np.pad(a, _WIDTH // 2, mode="edge")
    return np.convolve(padded, np.ones(_WIDTH + 1) / (_WIDTH + 1), mode="valid")


def _angle(t: FloatArray, phi: FloatArray, a: FloatArray, clear: np.ndarray) -> FloatArray:
    """sd (N,) of a phase or a frequency; infinite where it is lost."""
    count = int(np.count_nonzero(clear))
    out = np.full(t.size, np.inf)
    if count < _FEWEST * _WIDTH:
        return out
    v, inverse = _windows(t[:count], phi[:count]), _mean(1.0 / a[:count] ** 2)
    s2, r2 = _two(v, inverse, np.ones(inverse.size))
    out[:count] = np.sqrt(np.maximum(s2 / a[:count] ** 2 + r2, 1e-300))
    return out
