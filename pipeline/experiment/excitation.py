"""Excitations: drive samples v (N, D) in volts, N samples, D drives.

chirp      v_d = A_d cos(2 pi (f_a t + (f_b - f_a) t^2 / (2 T)) + phase): linear sweep from f_a to f_b over the record
multisine  v_d = sum_l a cos(2 pi f_l t + phi_l), random phases, scaled to the peak A_d
silence    v = 0
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray


@dataclass(frozen=True)
class Chirp:
    """A linear sweep on each drive; an amplitude of zero leaves a drive silent.

    ``start_hz``, ``stop_hz``, ``amplitude_v``: one value per drive [Hz, Hz, V]; ``duration_s`` [s].
    """

    start_hz: tuple[float, ...] = (400.0, 700.0)
    stop_hz: tuple[float, ...] = (700.0, 400.0)
    amplitude_v: tuple[float, ...] = (2.0, 2.0)
    duration_s: float = 3.0


@dataclass(frozen=True)
class Multisine:
    """Lines at the multiples of 1/period between ``low_hz`` and ``high_hz``, with random phases for each drive.

    ``amplitude_v``: peak, one value per drive [V]; ``duration_s``, ``period_s`` [s]; ``seed`` of the phases.
    """

    low_hz: float = 400.0
    high_hz: float = 700.0
    amplitude_v: tuple[float, ...] = (2.0, 2.0)
    duration_s: float = 3.0
    period_s: float = 3.0
    seed: int = 0


@dataclass(frozen=True)
class Silence:
    """All drives at zero for ``duration_s`` [s]."""

    drives: int = 2
    duration_s: float = 1.0


Excitation = Chirp | Multisine | Silence


def drive_samples(excitation: Excitation, sample_rate_hz: float) -> FloatArray:
    """Drive samples v (N, D) [V], N = round(duration f_s)."""
    count = round(excitation.duration_s * sample_rate_hz)
    t = np.arange(count) / sample_rate_hz
    if isinstance(excitation, Silence):
        return np.zeros((count, excitation.drives))
    if isinstance(excitation, Chirp):
        start, stop = np.array(excitation.start_hz), np.array(excitation.stop_hz)
        phase = t[:, None] * start + t[:, None] ** 2 * (stop - start) / (2.0 * excitation.duration_s)
        return np.array(excitation.amplitude_v) * np.cos(2.0 * np.pi * phase)
    period = round(excitation.period_s * sample_rate_hz)
    first = int(np.ceil(excitation.low_hz * excitation.period_s - 1e-9))
    last = int(np.floor(excitation.high_hz * excitation.period_s + 1e-9))
    amplitude = np.array(excitation.amplitude_v)
    phases = np.random.default_rng(excitation.seed).uniform(0.0, 2.0 * np.pi, (last - first + 1, amplitude.size))
    spectrum = np.zeros((period // 2 + 1, amplitude.size), dtype=np.complex128)
    spectrum[first : last + 1] = np.exp(1j * phases)
    wave = np.fft.irfft(spectrum, n=period, axis=0)
    wave = wave * (amplitude / np.max(np.abs(wave), axis=0))
    return np.asarray(np.resize(wave, (count, amplitude.size)))
