"""Simulated measurement of pick-off volts: hum, noise, ADC.

    y = Q(S + sum_h a_h cos(2 pi h f t + phi_h) + n),   Q rounds to the LSB and clips at full scale

The noise n is that of ``source``, white by default.  Hum phases are random, one for each channel and harmonic.
Shapes: S (N, senses) with N samples.  Units: volts, hertz.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache

import numpy as np

from ...arrays import FloatArray
from ..instrument import Adc
from .source import WHITE, NoiseKind, noise_volts


@dataclass(frozen=True)
class Hum:
    """Mains hum: amplitude ``amplitude_v[h-1]`` [V] at harmonic h of ``frequency_hz`` [Hz]."""

    frequency_hz: float = 60.0
    amplitude_v: tuple[float, ...] = ()


@lru_cache(maxsize=8)
def _waves(samples: int, sample_rate_hz: float, frequency_hz: float, harmonics: int) -> FloatArray:
    """Cosines, then sines (N, 2 harmonics) of the harmonics; read-only."""
    t = np.arange(samples) / sample_rate_hz
    angle = 2.0 * np.pi * frequency_hz * t[:, None] * np.arange(1, harmonics + 1)
    waves = np.concatenate([np.cos(angle), np.sin(angle)], axis=1)
    waves.setflags(write=False)
    return waves


def hum_period_v(hum: Hum, samples: int, sample_rate_hz: float, senses: int, random: np.random.Generator) -> FloatArray:
    """Hum (n, senses) [V] from t = 0, with random phases: the n <= ``samples`` samples of its period, or all."""
    amplitude = np.array(hum.amplitude_v)[:, None]
    phases = random.uniform(0.0, 2.0 * np.pi, (amplitude.size, senses))
    weights = np.concatenate([amplitude * np.cos(phases), -amplitude * np.sin(phases)])
    period = min(_period(sample_rate_hz, hum.frequency_hz, samples), samples)
    return _waves(period, sample_rate_hz, hum.frequency_hz, amplitude.size) @ weights


@lru_cache(maxsize=8)
def _period(sample_rate_hz: float, frequency_hz: float, most: int) -> int:
    """Fewest samples that hold whole periods of ``frequency_hz``, exactly; ``most`` where there are none below it."""
    samples = (Fraction(sample_rate_hz) / Fraction(frequency_hz)).numerator
    return samples if samples < most else most


def convert(volts: FloatArray, adc: Adc | None) -> FloatArray:
    """Q(v): the nearest code of a mid-tread ADC [V], for ``volts`` of any shape; unchanged without an ADC."""
    if adc is None:
        return volts
    half = 2.0 ** (adc.bits - 1)
    # In one array, which saves a tenth of the time.
    code = np.asarray(volts / adc.lsb_v)
    np.rint(code, out=code)
    np.clip(code, -half, half - 1.0, out=code)
    code *= adc.lsb_v
    return code


def measured(
    volts: FloatArray,
    sample_rate_hz: float,
    sigma_v: float,
    hum: Hum,
    adc: Adc | None,
    random: np.random.Generator,
    kind: NoiseKind = WHITE,
) -> FloatArray:
    """Pick-off ``volts`` (N, senses) with hum and noise of level ``sigma_v`` [V], after the ADC, (N, senses) [V]."""
    samples, senses = volts.shape
    total = noise_volts(kind, sigma_v, volts, sample_rate_hz, random)
    total += volts
    if hum.amplitude_v:
        one = hum_period_v(hum, samples, sample_rate_hz, senses, random)
        whole = samples // len(one) * len(one)
        total[:whole].reshape(-1, *one.shape)[:] += one
        total[whole:] += one[: samples - whole]
    return convert(total, adc)
