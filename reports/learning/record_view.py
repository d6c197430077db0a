"""Records beside a model: the curves and pictures of the page as numbers, and the choice of what is pictured.

    A(f_k) = 2 |sum_n x_n exp(-2 pi i k n / (p N))| / N      amplitude spectrum, zero padded p times [V]
    floor  = 2 sigma / sqrt(N)                               rms amplitude of white noise of sd sigma in it
    P(t, f)                                                  power of the whitened residual, 1 for noise alone

Shapes: N samples, D drives, S senses.  Units: volts, seconds, hertz; residuals in sigmas.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import fft

from pipeline.arrays import FloatArray

#: Most points of a curve and most columns of a picture: more would enlarge the page without showing more.
POINTS, COLUMNS = 420, 220
_PADDED = 4
#: Records and frequency windows that are pictured, and most records in the figures of level and channels.
_PICTURED, _WINDOWS, _RECORDS = 3, 4, 24


@dataclass(frozen=True, eq=False)
class RecordView:
    """One record and what one model predicts for it.

    Parameters
    ----------
    name : of the record.
    role : "fit" or "validate" (held out).
    sample_rate_hz : f_s [Hz].
    drive_v : (N, D) commanded drive samples [V].
    measured_v, model_v : (N, S) sense samples [V].
    residual : (N, S) in sigmas, without offset and lines.
    error : rms of the residual [sigma].
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
        """S, the number of sense channels."""
        return int(self.measured_v.shape[1])

    @property
    def resolution_hz(self) -> float:
        """Thirty lines of the record's Fourier transform [Hz]: a barely resolved resonance fills a few of them."""
        return 30.0 * self.sample_rate_hz / self.measured_v.shape[0]

    def channel_errors(self) -> FloatArray:
        """(S,) rms of the residual by channel [sigma]."""
        return np.asarray(np.sqrt(np.mean(self.residual**2, axis=0)))


#: A record with the first and with the last model (``None`` where there is only one model).
RecordPair = tuple[RecordView, RecordView | None]


@dataclass(frozen=True)
class FrequencyWindow:
    """Resonances [Hz] that are pictured together, and how far the picture extends beyond them [Hz]."""

    centres_hz: tuple[float, ...]
    half_hz: float

    @property
    def band_hz(self) -> tuple[float, float]:
        """(low, high) [Hz]: from below the first to above the last resonance; low is at least 0."""
        return max(self.centres_hz[0] - self.half_hz, 0.0), self.centres_hz[-1] + self.half_hz


def record_pairs(before: Sequence[RecordView], after: Sequence[RecordView] | None) -> list[RecordPair]:
    """Records with the first and the last model, paired by name; records too short for a spectrum are left out."""
    later = {view.name: view for view in after or ()}
    usable = [view for view in before if view.measured_v.shape[0] >= 64 and view.residual.size][:_RECORDS]
    matches = [(view, later.get(view.name)) for view in usable]
    return [
        (view, other if other is not None and other.residual.shape == view.residual.shape else None)
        for view, other in matches
    ]


def pictured(pairs: Sequence[RecordPair]) -> list[RecordPair]:
    """The worst fitted and the worst held-out record, then the worst of the others; repeats of a drive only once."""
    order = sorted(pairs, key=lambda pair: -pair[0].error)
    first = [next((pair for pair in order if pair[0].role == role), None) for role in ("fit", "validate")]
    chosen = [pair for pair in first if pair is not None]
    for pair in order:
        repeated = any(np.array_equal(pair[0].drive_v, other.drive_v) for other, _ in chosen)
        if not repeated and len(chosen) < _PICTURED:
            chosen.append(pair)
    return chosen


def resonance_windows(parameters: Mapping[str, float], views: Sequence[RecordView]) -> list[FrequencyWindow]:
    """Windows [Hz] around the model's resonances, close ones together; around the largest response where it has none.

    Parameters
    ----------
    parameters : of the model; f1_hz [Hz], zeta1 and so on are the resonances, those above Nyquist are left out.
    views : the records.
    """
    if not views:
        return []
    known = sorted(
        (frequency, 20.0 * parameters.get(f"zeta{name[1:-3]}", 0.0) * frequency)
        for name, frequency in parameters.items()
        if re.fullmatch(r"f\d*_hz", name) and frequency > 0.0
    ) or _largest_response(views)
    windows: list[FrequencyWindow] = []
    for frequency, width in known:
        half = max(width, views[0].resolution_hz)
        if windows and frequency - windows[-1].centres_hz[-1] < half:
            last = windows.pop()
            windows.append(FrequencyWindow((*last.centres_hz, frequency), max(last.half_hz, half)))
        else:
            windows.append(FrequencyWindow((frequency,), half))
    nyquist = 0.5 * min(view.sample_rate_hz for view in views)
    return [window for window in windows if window.centres_hz[-1] < nyquist][:_WINDOWS]


def _largest_response(views: Sequence[RecordView]) -> list[tuple[float, float]]:
    view = max(views, key=lambda view: float(np.ptp(view.measured_v)))
    found = spectra(view, drive_band(view))
    if not found.frequency_hz.size:
        return []
    return [(float(found.frequency_hz[int(np.argmax(found.measured.max(axis=1)))]), 0.0)]


def sigma_v(view: RecordView) -> FloatArray:
    """(S,) sigma [V] that converts the residual to volts; nan where the residual is zero.

    Median of |measured - model - median| / |residual|, which a few removed lines hardly change.
    """
    volts = view.measured_v - view.model_v
    if not volts.size:
        return np.full(view.senses, np.nan)
    spread = np.median(np.abs(volts - np.median(volts, axis=0)), axis=0)
    white = np.median(np.abs(view.residual - np.median(view.residual, axis=0)), axis=0)
    return np.asarray(np.divide(spread, white, out=np.full(view.senses, np.nan), where=white > 0.0))


@dataclass(frozen=True, eq=False)
class RecordSpectra:
    """Amplitude spectra [V] of one record in a band: frequency (F,), curves (F, S); noise floor (S,)."""

    frequency_hz: FloatArray
    measured: FloatArray
    model: FloatArray
    residual: FloatArray
    floor: FloatArray


def spectra(view: RecordView, band_hz: tuple[float, float]) -> RecordSpectra:
    """Amplitude spectra of measurement, model and residual within a band [Hz]."""
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
    # The maximum of each group keeps the peaks that a plain selection of points could miss.
    starts = np.arange(0, frequency.size, step)
    measured, model, left = (np.maximum.reduceat(curve, starts, axis=0) if starts.size else curve for curve in curves)
    return RecordSpectra(frequency[starts], measured, model, left, 2.0 * sigma / np.sqrt(n))


@dataclass(frozen=True, eq=False)
class TimeFrequency:
    """Power of a whitened residual: time (T,), frequency (F,), decibels above the noise (F, T)."""

    time_s: FloatArray
    frequency_hz: FloatArray
    over_noise_db: FloatArray


def time_frequency(view: RecordView, segments: float, band_hz: tuple[float, float]) -> TimeFrequency:
    """10 log10 P of the residual in a band [Hz], mean over the channels; a segment is 1/``segments`` of the record."""
    # Loading scipy.signal takes a third of a second, and a command without a page does not need it.
    from scipy import signal

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
    # The one-sided density of unit white noise is 2 / f_s.
    mean = 0.5 * view.sample_rate_hz * np.mean(power, axis=0)
    chosen = (frequency >= band_hz[0]) & (frequency <= band_hz[1]) & (frequency > 0.0)
    rows, groups = mean[chosen], max(1, -(-int(chosen.sum()) // 140))
    starts = np.arange(0, rows.shape[0], groups)
    pooled = np.add.reduceat(rows, starts, axis=0) / np.diff(np.append(starts, rows.shape[0]))[:, None]
    middle = np.add.reduceat(frequency[chosen], starts) / np.diff(np.append(starts, rows.shape[0]))
    return TimeFrequency(np.asarray(time), middle, 10.0 * np.log10(np.maximum(pooled, 1e-3)))


def drive_frequency(view: RecordView) -> tuple[FloatArray, FloatArray]:
    """(T,) times [s] and (D, T) instantaneous frequencies [Hz] of the drives that are sweeps or tones.

    f = d arg(v + i H v)/dt / 2 pi with the Hilbert transform H, averaged over a hundredth of the record.
    """
    from scipy import signal

    n = view.drive_v.shape[0]
    width = max(n // 100, 2)
    times = (np.arange(n // width) + 0.5) * width / view.sample_rate_hz
    found = []
    for drive in view.drive_v.T:
        if not np.any(drive) or n < 64:
            continue
        analytic = signal.hilbert(drive - drive.mean())
        envelope = np.abs(analytic)[n // 20 : -n // 20]
        # The envelope of a sweep is constant, that of a multisine or of noise is not.
        if envelope.std() > 0.25 * envelope.mean():
            continue
        phase = np.unwrap(np.angle(analytic))
        advance = np.diff(phase[: n // width * width : width], append=phase[n // width * width - 1])
        rate = advance / (2.0 * np.pi * width) * view.sample_rate_hz
        rate[[0, -1]] = np.nan
        found.append(rate)
    return times, np.array(found).reshape(len(found), times.size)


def drive_band(view: RecordView) -> tuple[float, float]:
    """Band [Hz] that holds 98 % of the power of the drives; (0, f_s/2) for a silent record."""
    power = np.sum(np.abs(fft.rfft(view.drive_v - view.drive_v.mean(axis=0), axis=0)) ** 2, axis=1)
    if not power.sum() > 0.0:
        return 0.0, 0.5 * view.sample_rate_hz
    share = np.cumsum(power) / power.sum()
    step = view.sample_rate_hz / view.drive_v.shape[0]
    return float(np.searchsorted(share, 0.01) * step), float(np.searchsorted(share, 0.99) * step)


def by_level(view: RecordView, channel: int, bins: int = 12) -> tuple[FloatArray, FloatArray]:
    """Response level (b,) [V rms] and rms of the residual (b,) [sigma] of one channel, by bins of level.

    Blocks of 1/500 of the record are sorted by their level into ``bins`` bins of equal ratio; bins with fewer than three
    blocks are left out.
    """
    length = max(view.measured_v.shape[0] // 500, 4)
    count = view.measured_v.shape[0] // length
    if count == 0:
        return np.zeros(0), np.zeros(0)
    measured = view.measured_v[: count * length, channel]
    response = (measured - np.mean(measured)).reshape(count, length)
    level = np.sqrt(np.mean(response**2, axis=1))
    power = np.mean(view.residual[: count * length, channel].reshape(count, length) ** 2, axis=1)
    positive = level > 0.0
    if not positive.any():
        return np.zeros(0), np.zeros(0)
    edges = np.geomspace(level[positive].min(), level.max() * (1.0 + 1e-9), bins + 1)
    bin_of = np.clip(np.searchsorted(edges, level[positive], side="right") - 1, 0, bins - 1)
    n = np.bincount(bin_of, minlength=bins)
    rms = np.sqrt(np.bincount(bin_of, weights=power[positive], minlength=bins) / np.maximum(n, 1))
    return np.sqrt(edges[:-1] * edges[1:])[n >= 3], rms[n >= 3]
