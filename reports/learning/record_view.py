"""A record beside a model, and what the pictures of it need.

    A(f_k) = 2 |sum_n x_n exp(-2 pi i k n / (p N))| / N      amplitude spectrum, zero padded p times [V]
    floor  = 2 sigma / sqrt(N)                               rms amplitude of white noise of sd sigma in it
    P(t, f)                                                  power of the whitened residual, 1 where it is noise

Shapes: N samples, D drives, S senses.  Units: volts, seconds, hertz; residuals in sigmas.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import fft, signal

from pipeline.arrays import FloatArray

#: Most points of a curve and most columns of a picture: more is not seen, and the page grows.
POINTS, COLUMNS = 420, 220
_PADDED = 4


@dataclass(frozen=True, eq=False)
class RecordView:
    """One record as one model explains it.

    Parameters
    ----------
    name : of the record.
    role : "fit" or "validate" (held out).
    sample_rate_hz : f_s [Hz].
    drive_v : (N, D) commanded drive samples [V].
    measured_v, model_v : (N, S) sense samples [V].
    residual : (N, S) in sigmas, offset and lines taken out.
    error : rms of the residual.
    """

    name: str
    role: str
    sample_rate_hz: float
    drive_v: FloatArray
    measured_v: FloatArray
    model_v: FloatArray
    residual: FloatArray
    error: float

    @property
    def senses(self) -> int:
        """S."""
        return int(self.measured_v.shape[1])

    def channel_errors(self) -> FloatArray:
        """(S,) rms of the residual by channel."""
        if not self.residual.size:
            return np.full(self.senses, np.nan)
        return np.asarray(np.sqrt(np.mean(self.residual**2, axis=0)))


def sigma_v(view: RecordView) -> FloatArray:
    """(S,) sigma [V] that makes the residual volts; nan where the residual vanishes.

    Median of |measured - model - median| / |residual|, which a few taken-out lines do not move far.
    """
    volts = view.measured_v - view.model_v
    if not volts.size:
        return np.full(view.senses, np.nan)
    spread = np.median(np.abs(volts - np.median(volts, axis=0)), axis=0)
    white = np.median(np.abs(view.residual - np.median(view.residual, axis=0)), axis=0)
    return np.asarray(np.divide(spread, white, out=np.full(view.senses, np.nan), where=white > 0.0))


@dataclass(frozen=True, eq=False)
class RecordSpectra:
    """Amplitude spectra [V] of one record in a window: frequency (F,), the rest (F, S); floor (S,) of the noise."""

    frequency_hz: FloatArray
    measured: FloatArray
    model: FloatArray
    residual: FloatArray
    floor: FloatArray


def spectra(view: RecordView, band_hz: tuple[float, float]) -> RecordSpectra:
    """Amplitude spectra of measured, model and residual within a band [Hz]."""
    n = view.measured_v.shape[0]
    size = fft.next_fast_len(_PADDED * n, real=True)
    low, high = (round(edge * size / view.sample_rate_hz) for edge in band_hz)
    chosen = slice(max(low, 1), min(high, size // 2) + 1)
    sigma = sigma_v(view)

    def amplitude(x: FloatArray) -> FloatArray:
        return np.asarray(2.0 / n * np.abs(fft.rfft(x - x.mean(axis=0), size, axis=0)[chosen]))

    frequency = np.arange(size // 2 + 1)[chosen] * view.sample_rate_hz / size
    residual = view.residual * np.where(np.isfinite(sigma), sigma, 0.0)
    curves = [amplitude(x) for x in (view.measured_v, view.model_v, residual)]
    step = max(1, -(-frequency.size // POINTS))
    # The largest of each group: peaks must not fall between the points that are kept.
    starts = np.arange(0, frequency.size, step)
    measured, model, left = (np.maximum.reduceat(curve, starts, axis=0) if starts.size else curve for curve in curves)
    return RecordSpectra(frequency[starts], measured, model, left, 2.0 * sigma / np.sqrt(n))


@dataclass(frozen=True, eq=False)
class TimeFrequency:
    """Power of a whitened residual: time (T,), frequency (F,), decibels over the noise (F, T)."""

    time_s: FloatArray
    frequency_hz: FloatArray
    over_noise_db: FloatArray


def time_frequency(view: RecordView, segments: float, band_hz: tuple[float, float]) -> TimeFrequency:
    """10 log10 P, mean over the channels, of the residual in a band [Hz], with segments of 1 / ``segments`` of a record."""
    n = view.residual.shape[0]
    length = int(np.clip(2 ** round(np.log2(max(n / segments, 8.0))), 8, max(n, 8)))
    hop = max(length // 4, -(-n // COLUMNS))
    frequency, time, power = signal.spectrogram(
        view.residual.T,
        fs=view.sample_rate_hz,
        window="hann",
        nperseg=min(length, n),
        noverlap=max(min(length, n) - hop, 0),
        detrend=False,
        scaling="density",
    )
    # One-sided density of unit white noise is 2 / f_s.
    mean = 0.5 * view.sample_rate_hz * np.mean(power, axis=0)
    chosen = (frequency >= band_hz[0]) & (frequency <= band_hz[1]) & (frequency > 0.0)
    rows, groups = mean[chosen], max(1, -(-int(chosen.sum()) // 140))
    starts = np.arange(0, rows.shape[0], groups)
    pooled = np.add.reduceat(rows, starts, axis=0) / np.diff(np.append(starts, rows.shape[0]))[:, None]
    middle = np.add.reduceat(frequency[chosen], starts) / np.diff(np.append(starts, rows.shape[0]))
    return TimeFrequency(np.asarray(time), middle, 10.0 * np.log10(np.maximum(pooled, 1e-3)))


def drive_frequency(view: RecordView) -> tuple[FloatArray, FloatArray]:
    """(T,) times and (D, T) instantaneous frequencies [Hz] of the drives; no rows of drives that are no sweep or tone.

    f = d arg(v + i H v) / dt / 2 pi, averaged over a hundredth of the record.
    """
    n = view.drive_v.shape[0]
    width = max(n // 100, 2)
    times = (np.arange(n // width) + 0.5) * width / view.sample_rate_hz
    found = []
    for drive in view.drive_v.T:
        if not np.any(drive) or n < 64:
            continue
        analytic = signal.hilbert(drive - drive.mean())
        envelope = np.abs(analytic)[n // 20 : -n // 20]
        # A sweep has a steady envelope, a multisine or noise has not.
        if envelope.std() > 0.25 * envelope.mean():
            continue
        phase = np.unwrap(np.angle(analytic))
        turns = np.diff(phase[: n // width * width : width], append=phase[n // width * width - 1])
        rate = turns / (2.0 * np.pi * width) * view.sample_rate_hz
        rate[[0, -1]] = np.nan
        found.append(rate)
    return times, np.array(found).reshape(len(found), times.size)


def drive_band(view: RecordView) -> tuple[float, float]:
    """Frequencies [Hz] between which 98 % of the power of the drives lies; (0, f_s/2) for silence."""
    power = np.sum(np.abs(fft.rfft(view.drive_v - view.drive_v.mean(axis=0), axis=0)) ** 2, axis=1)
    if not power.sum() > 0.0:
        return 0.0, 0.5 * view.sample_rate_hz
    share = np.cumsum(power) / power.sum()
    step = view.sample_rate_hz / view.drive_v.shape[0]
    return float(np.searchsorted(share, 0.01) * step), float(np.searchsorted(share, 0.99) * step)


def by_level(view: RecordView, channel: int, bins: int = 12) -> tuple[FloatArray, FloatArray]:
    """Levels of the response [V, rms] and rms of the residual [sigmas] there, from short blocks of one channel.

    Blocks of 1/500 of the record are gathered by their level into ``bins`` bins of equal ratio; bins of fewer than
    three blocks are left out.
    """
    length = max(view.measured_v.shape[0] // 500, 4)
    count = view.measured_v.shape[0] // length
    if count == 0:
        return np.zeros(0), np.zeros(0)
    measured = view.measured_v[: count * length, channel]
    response = (measured - np.mean(measured)).reshape(count, length)
    level = np.sqrt(np.mean(response**2, axis=1))
    power = np.mean(view.residual[: count * length, channel].reshape(count, length) ** 2, axis=1)
    seen = level > 0.0
    if not seen.any():
        return np.zeros(0), np.zeros(0)
    edges = np.geomspace(level[seen].min(), level.max() * (1.0 + 1e-9), bins + 1)
    bin_of = np.clip(np.searchsorted(edges, level[seen], side="right") - 1, 0, bins - 1)
    n = np.bincount(bin_of, minlength=bins)
    rms = np.sqrt(np.bincount(bin_of, weights=power[seen], minlength=bins) / np.maximum(n, 1))
    return np.sqrt(edges[:-1] * edges[1:])[n >= 3], rms[n >= 3]
