"""Noise of the pick-off volts: white, autoregressive, 1/f, or white with sampling jitter or gain noise.

    white     n[k] = sigma e[k]
    ar        n[k] = a n[k-1] + sigma sqrt(1 - a^2) e[k]             sd sigma, density ~ 1 / |1 - a e^{-iw}|^2
    1/f       density 2 sigma^2 / f_s (1 + f_c / f)                  sigma is the sd of the white part
    jitter    n[k] = sigma e[k] + S'(t_k) delta[k],  delta ~ N(0, tau^2)   one clock samples all channels: delta is common
    gain      n[k] = sigma e[k] + S(t_k) g[k],      g ~ N(0, gamma^2)     one reference voltage: g is common

e is white with unit variance and independent between channels.  The 1/f noise is a stretch of a record that is ``_LONGER`` times
as long, so silence and driven record differ in their slow drift as they do on a bench.

Shapes: N samples, S senses.  Volts, seconds, hertz.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq

from ...arrays import FloatArray

Kind = Literal["white", "ar", "1/f", "jitter", "gain"]

_LONGER = 4


@dataclass(frozen=True)
class NoiseKind:
    """The kind of noise.

    Parameters
    ----------
    kind : "white", "ar", "1/f", "jitter" or "gain".
    coefficient : a of the autoregressive noise, in (-1, 1).
    corner_hz : f_c of the 1/f noise [Hz].
    jitter_s : tau, the sd of the sampling instants [s].
    gain_noise : gamma, the sd of the gain from sample to sample [1].
    """

    kind: Kind = "white"
    coefficient: float = 0.7
    corner_hz: float = 1000.0
    jitter_s: float = 3e-7
    gain_noise: float = 1e-3


WHITE = NoiseKind()


def slope_v_per_s(volts: FloatArray, sample_rate_hz: float) -> FloatArray:
    """dS/dt (N, S) [V/s] of samples (N, S) [V], by differences of fourth order; of first order at the two samples of each end.

    Its relative error is (2 pi f / f_s)^4 / 30: 5e-4 at a twelfth of the sample rate.
    """
    out = np.gradient(volts, axis=0)
    out[2:-2] = (8.0 * (volts[3:-1] - volts[1:-3]) - (volts[4:] - volts[:-4])) / 12.0
    return np.asarray(out * sample_rate_hz)


def noise_volts(
    kind: NoiseKind, sigma_v: float, volts: FloatArray, sample_rate_hz: float, random: np.random.Generator
) -> FloatArray:
    """Noise (N, S) [V] of level ``sigma_v`` [V] on pick-off ``volts`` (N, S), which matter for jitter and gain noise only."""
    samples, senses = volts.shape
    if kind.kind == "ar":
        # Loading scipy.signal takes 0.7 s, and few runs need it.
        from scipy.signal import lfilter

        # The start-up dies out as a^k; after 40/(1 - |a|) samples it is below 1e-17.
        settle = int(40.0 / (1.0 - abs(kind.coefficient))) + 1
        fresh = random.standard_normal((samples + settle, senses))
        scale = sigma_v * np.sqrt(1.0 - kind.coefficient**2)
        return np.asarray(lfilter([scale], [1.0, -kind.coefficient], fresh, axis=0))[settle:]
    if kind.kind == "1/f":
        whole = next_fast_len(_LONGER * samples, real=True)
        frequency = rfftfreq(whole, 1.0 / sample_rate_hz)
        gain = np.sqrt(1.0 + kind.corner_hz / np.maximum(frequency, frequency[1]))
        spectrum = rfft(random.standard_normal((whole, senses)), axis=0) * gain[:, None]
        return np.asarray(sigma_v * irfft(spectrum, n=whole, axis=0))[:samples]
    white = random.standard_normal(volts.shape)
    white *= sigma_v
    if kind.kind == "white":
        return white
    common = random.standard_normal((samples, 1))
    if kind.kind == "gain":
        return np.asarray(white + kind.gain_noise * volts * common)
    return np.asarray(white + slope_v_per_s(volts, sample_rate_hz) * (kind.jitter_s * common))
