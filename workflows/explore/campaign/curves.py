"""Residuals of one record as curves: by frequency, by time, by level; in units of the noise or in volts.

Shapes: K points of a curve; S senses.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.arrays import FloatArray
from reports.learning.record_view import (
    RecordView,
    by_level,
    drive_band,
    pictured,
    record_pairs,
    resonance_windows,
    sigma_v,
    spectra,
)
from reports.words.explore_loop import band_words

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


def bands(parameters: Mapping[str, float], view: RecordView) -> dict[str, tuple[float, float]]:
    """Bands that may be shown, by their words: that of the drive, around the resonances, all; [Hz]."""
    low, high = drive_band(view)
    room = max(0.2 * (high - low), view.resolution_hz)
    nyquist = 0.5 * view.sample_rate_hz
    found: list[tuple[tuple[float, float], str, tuple[float, ...]]]
    found = [((max(low - room, 0.0), min(high + room, nyquist)), "drive", ())]
    found += [(one.band_hz, "resonance", one.centres_hz) for one in resonance_windows(parameters, [view])]
    found.append(((0.0, nyquist), "full", ()))
    return {band_words(kind, band, centres): band for band, kind, centres in found}


def worst(views: Sequence[RecordView]) -> str:
    """Name of the record with the largest error."""
    return pictured(record_pairs(views, None))[0][0].name if views else ""


def by_frequency(view: RecordView, channel: int, band_hz: tuple[float, float], whitened: bool) -> SpectrumCurves:
    """Amplitude spectra of one channel in a band [Hz]: in volts, or divided by the rms amplitude of the noise."""
    found = spectra(view, band_hz)
    floor = float(found.floor[channel])
    scale = 1.0 / floor if whitened and np.isfinite(floor) and floor > 0.0 else 1.0
    measured, model, residual = (scale * curve[:, channel] for curve in (found.measured, found.model, found.residual))
    return SpectrumCurves(found.frequency_hz, measured, model, residual, scale * floor)


def by_time(view: RecordView, channel: int, whitened: bool) -> Curve:
    """rms of the residual of one channel in blocks of 1/300 of the record, by time [s]: in sigmas, or in volts."""
    length = max(view.residual.shape[0] // BLOCKS, 1)
    count = view.residual.shape[0] // length
    power = view.residual[: count * length, channel].reshape(count, length) ** 2
    times = (np.arange(count) + 0.5) * length / view.sample_rate_hz
    return Curve(times, np.sqrt(power.mean(axis=1)) * _unit(view, channel, whitened))


def by_response(view: RecordView, channel: int, whitened: bool) -> Curve:
    """rms of the residual of one channel by the rms of its response [V]: in sigmas, or in volts."""
    level, rms = by_level(view, channel)
    return Curve(level, rms * _unit(view, channel, whitened))


def by_drive(views: Sequence[RecordView], channel: int, whitened: bool) -> Curve:
    """rms of the residual of one channel in each record by its largest drive [V]: in sigmas, or in volts."""
    level = np.array([float(np.max(np.abs(view.drive_v), initial=0.0)) for view in views])
    rms = [float(np.sqrt(np.mean(v.residual[:, channel] ** 2))) * _unit(v, channel, whitened) for v in views]
    return Curve(level, np.array(rms))


def _unit(view: RecordView, channel: int, whitened: bool) -> float:
    return 1.0 if whitened else float(sigma_v(view)[channel])
