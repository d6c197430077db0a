"""Residuals of one record as curves: by frequency, by time, by level; in units of the noise or in volts.

Shapes: K points of a curve; S senses.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.arrays import FloatArray
from reports.learning.decay_view import DecayView
from reports.learning.record_view import (
    RecordView,
    by_level,
    drive_band,
    resonance_windows,
    sigma_v,
    spectra,
)
from reports.learning.tone_view import ToneView
from reports.words.explore_loop import band_words

#: What is shown: a record in time, a pass of a sweep or of a frequency response, or the amplitudes of a decay.
View = RecordView | ToneView | DecayView
#: Blocks of a record over time.
BLOCKS = 300


@dataclass(frozen=True, eq=False)
class Curve:
    """Values ``y`` (K,) at ``x`` (K,)."""

    x: FloatArray
    y: FloatArray


@dataclass(frozen=True, eq=False)
class SpectrumCurves:
    """Amplitudes (K,) at ``frequency_hz`` (K,), and what noise alone gives on average."""

    frequency_hz: FloatArray
    measured: FloatArray
    model: FloatArray
    residual: FloatArray
    noise: float


def name_of(view: View) -> str:
    """The name by which a record or a pass is chosen."""
    if isinstance(view, DecayView):
        return view.record
    return view.name if isinstance(view, RecordView) else f"{view.record}: {view.label}"


def error_of(view: View) -> float:
    """rms of the residual over all channels [sigma]."""
    return view.error if isinstance(view, RecordView) else float(np.sqrt(np.mean(view.residual**2)))


def bands(parameters: Mapping[str, float], view: View) -> dict[str, tuple[float, float]]:
    """Bands that may be shown, by their words: that of the drive, around the resonances, all; [Hz].  None of a decay."""
    if isinstance(view, DecayView):
        return {}
    if isinstance(view, ToneView):
        whole = float(view.frequency_hz.min()), float(view.frequency_hz.max())
        return {band_words("drive", whole, ()): whole}
    low, high = drive_band(view)
    room = max(0.2 * (high - low), view.resolution_hz)
    nyquist = 0.5 * view.sample_rate_hz
    found: list[tuple[tuple[float, float], str, tuple[float, ...]]]
    driven = bool(np.any(view.drive_v))
    found = [((max(low - room, 0.0), min(high + room, nyquist)), "drive", ())] if driven else []
    found += [(one.band_hz, "resonance", one.centres_hz) for one in resonance_windows(parameters, [view])]
    found.append(((0.0, nyquist), "full", ()))
    return {band_words(kind, band, centres): band for band, kind, centres in found}


def worst(views: Sequence[View]) -> str:
    """Name of the record or pass with the largest error."""
    return name_of(max(views, key=error_of)) if views else ""


def by_frequency(view: View, channel: int, band_hz: tuple[float, float], whitened: bool) -> SpectrumCurves:
    """Amplitude spectra of one channel in a band [Hz]: in volts, or divided by the rms amplitude of the noise.

    A decay has none.
    """
    if isinstance(view, DecayView):
        none = np.zeros(0)
        return SpectrumCurves(none, none, none, none, np.nan)
    if isinstance(view, ToneView):
        order = np.argsort(view.frequency_hz, kind="stable")
        noise = _unit(view, channel, False)
        scale = 1.0 / noise if whitened and noise > 0.0 else 1.0
        measured, model = (scale * np.abs(x[order, channel]) for x in (view.measured_v, view.model_v))
        left = view.residual[order, channel] * scale * noise
        return SpectrumCurves(view.frequency_hz[order], measured, model, left, scale * noise)
    found = spectra(view, band_hz)
    floor = float(found.floor[channel])
    scale = 1.0 / floor if whitened and np.isfinite(floor) and floor > 0.0 else 1.0
    measured, model, residual = (scale * curve[:, channel] for curve in (found.measured, found.model, found.residual))
    return SpectrumCurves(found.frequency_hz, measured, model, residual, scale * floor)


def by_time(view: View, channel: int, whitened: bool) -> Curve:
    """rms of the residual of one channel in blocks of 1/300 of the record, by time [s]: in sigmas, or in volts.

    Of a sweep or a response each row, by its number: its rows are not sampled in time.
    """
    if isinstance(view, DecayView):
        return _blocks(view.time_s, _left(view, channel, whitened))
    if isinstance(view, ToneView):
        rows = np.arange(1.0, view.residual.shape[0] + 1.0)
        return Curve(rows, view.residual[:, channel] * _unit(view, channel, whitened))
    length = max(view.residual.shape[0] // BLOCKS, 1)
    count = view.residual.shape[0] // length
    power = view.residual[: count * length, channel].reshape(count, length) ** 2
    times = (np.arange(count) + 0.5) * length / view.sample_rate_hz
    return Curve(times, np.sqrt(power.mean(axis=1)) * _unit(view, channel, whitened))


def decay(view: DecayView, channel: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Time [s], measured amplitude and that of the model [V] of one channel; each is (K,)."""
    return view.time_s, view.measured_v[:, channel], view.model_v[:, channel]


def _left(view: DecayView, channel: int, whitened: bool) -> FloatArray:
    """(N,) residual of the rows of a decay in sigmas, or of their amplitudes in volts."""
    return (view.residual if whitened else np.abs(view.measured_v - view.model_v))[:, channel]


def _blocks(x: FloatArray, y: FloatArray) -> Curve:
    """rms of ``y`` (N,) in blocks of 1/300 of the rows, at their mean ``x`` (N,)."""
    edges = np.linspace(0, x.size, min(BLOCKS, x.size) + 1).astype(np.int64)
    size = np.diff(edges)
    mean = np.add.reduceat(x, edges[:-1]) / size
    return Curve(mean, np.sqrt(np.add.reduceat(y**2, edges[:-1]) / size))


def by_response(view: View, channel: int, whitened: bool) -> Curve:
    """rms of the residual of one channel by the rms of its response [V]: in sigmas, or in volts."""
    if isinstance(view, DecayView):
        order = np.argsort(view.measured_v[:, channel], kind="stable")
        level = view.measured_v[order, channel] / np.sqrt(2.0)
        return _blocks(level, _left(view, channel, whitened)[order])
    if isinstance(view, ToneView):
        order = np.argsort(np.abs(view.measured_v[:, channel]))
        level = np.abs(view.measured_v[order, channel]) / np.sqrt(2.0)
        return Curve(level, view.residual[order, channel] * _unit(view, channel, whitened))
    level, rms = by_level(view, channel)
    return Curve(level, rms * _unit(view, channel, whitened))


def by_drive(views: Sequence[View], channel: int, whitened: bool) -> Curve:
    """rms of the residual of one channel in each record by its largest drive [V]: in sigmas, or in volts.

    By its largest response where no record has a drive.
    """
    level = [largest_drive(view) for view in views]
    if not any(level):
        level = [float(np.max(np.abs(view.measured_v[:, channel]))) for view in views]
    left = [_left(v, channel, whitened) if isinstance(v, DecayView) else v.residual[:, channel] for v in views]
    rms = [float(np.sqrt(np.mean(own**2))) * _unit(v, channel, whitened) for own, v in zip(left, views)]
    return Curve(np.array(level), np.array(rms))


def largest_drive(view: View) -> float:
    """Largest drive of a record [V]; 0 of free motion."""
    if isinstance(view, DecayView):
        return 0.0
    drive = view.drive_v if isinstance(view, RecordView) else view.level_v
    return float(np.max(np.abs(drive), initial=0.0))


def _unit(view: View, channel: int, whitened: bool) -> float:
    """1, or sigma [V] of one channel."""
    if whitened or isinstance(view, DecayView):
        return 1.0
    if isinstance(view, RecordView):
        return float(sigma_v(view)[channel])
    volts, white = np.abs(view.measured_v - view.model_v)[:, channel], view.residual[:, channel]
    return float(np.median(volts[white > 0.0] / white[white > 0.0])) if np.any(white > 0.0) else 0.0
