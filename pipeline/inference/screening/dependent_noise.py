"""Noise that depends on the signal: sampling jitter and gain noise, estimated where the model has no signal.

    r_a(t) = n_a(t) + c_a(t) delta_a(t),     cov(delta_a, delta_b) = T_ab,   white

    jitter        c = S'(t), the slope     delta [s], of the sampling instants
    gain noise    c = S(t), the level      delta [1], of the gain from sample to sample (reference voltage)

Silence does not show them.  The residual above the highest harmonics of the band shows them and nothing of a missing effect of
the mechanics: high-passed to a two-sided width B, its mean square is

    E r_a r_b (t) = [a = b] sigma_a^2 + T_ab u_ab(t),     u_ab = (h^2 * c_a c_b)(t),   h the high pass, h^2 <-> (B - |f|)/f_s

with sigma_a^2 from the silent record, so T_ab follows from a regression weighted by the variance of r_a r_b.  Slope and level
are a quarter of a period apart, so the kind that is present explains more.  The more significant one enters the likelihood; it
never enters sigma.

Noise spreads over all cells of time and frequency; the harmonics of a nonlinear device, or of a converter that clips, stand on
ridges.  So the coefficients of a lapped transform of that band, each over its sd, must not have the kurtosis of ridges; where
they have, nothing is found, and the harmonics stay a misfit.

A record that does not start at rest is seen through a Hann window w, c and sigma too: else the misfit of a wrong model leaks into
the band (a beam with magnets, whose hardening passed for gain noise of 9 %).

A record that was advanced by phi samples, by an all-pass filter g, has interpolated noise:

    cov_ab(k) = T_ab sum_j g(k - j)^2 (c_a c_b)(j - phi)

Shapes: N samples, S senses.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import combinations
from typing import Literal

import numpy as np
from scipy.fft import irfft, rfft, rfftfreq

from ...arrays import FloatArray
from ...experiment.noise.source import slope_v_per_s
from ...experiment.noise.spectrum import NoiseSpectrum
from ...experiment.noise.time_frequency import bin_frequencies, block_size, lapped
from ...experiment.variation import advance_response

DependentKind = Literal["jitter", "gain"]
#: Column of the devices table, and key of the answers, by kind.
COLUMNS: dict[DependentKind, str] = {"jitter": "jitter_s", "gain": "gain_noise"}
#: Smallest significance [sd] of a variance component: one false alarm in 30,000 devices.
_SIGNIFICANT = 4.0
_REWEIGHTED = 3
#: Largest excess kurtosis of the coefficients [sd].  Jitter, gain noise and coloured noise reach 4.0 (18 records of bench-none,
#: seed 2031); a clipped record has 76, and without this its clipping at SNR 271 was "adequate" (left-out 0, seed 2043).
_RIDGES = 8.0


@dataclass(frozen=True, eq=False)
class DependentNoise:
    """A kind of noise that depends on the signal.

    Parameters
    ----------
    kind : "jitter" or "gain".
    covariance : T (S, S) of delta, [s^2] for jitter and [1] for gain noise.
    significance : of the larger channel [sd].
    """

    kind: DependentKind
    covariance: FloatArray
    significance: float

    @property
    def rms(self) -> float:
        """rms of delta over the channels, [s] for jitter and [1] for gain noise."""
        return float(np.sqrt(np.mean(np.diag(self.covariance))))

    def columns(self) -> dict[str, float]:
        """The rms under the name of its column."""
        return {COLUMNS[self.kind]: self.rms}

    def factor(self, volts: FloatArray, rate_hz: float) -> FloatArray:
        """c (N, S) of model ``volts`` (N, S) [V]."""
        return factor_of(self.kind, volts, rate_hz)

    def variances(self, volts: FloatArray, rate_hz: float) -> FloatArray:
        """v (3, N) [V^2] of the channel pairs (0, 0), (0, 1), (1, 1) of two senses at model ``volts`` (N, 2) [V]."""
        c, t = self.factor(volts, rate_hz).T, self.covariance
        return np.stack([t[0, 0] * c[0] ** 2, t[0, 1] * c[0] * c[1], t[1, 1] * c[1] ** 2])


def factor_of(kind: DependentKind, volts: FloatArray, rate_hz: float) -> FloatArray:
    """c (N, S) of a kind at model ``volts`` (N, S) [V]."""
    return slope_v_per_s(volts, rate_hz) if kind == "jitter" else volts


def advanced_products(product: FloatArray, shift: float) -> FloatArray:
    """Products c_a c_b (.., N) of a record that was advanced by ``shift`` samples (head of this module)."""
    if shift == 0.0:
        return product
    samples = product.shape[-1]
    spread = rfft(irfft(advance_response(samples, shift), n=samples) ** 2)
    later = np.exp(-2j * np.pi * rfftfreq(samples) * shift)
    return np.asarray(irfft(rfft(product) * spread * later, n=samples))


def find_dependent_noise(
    residual_v: FloatArray,
    volts: FloatArray,
    noise: NoiseSpectrum,
    signal_hz: float,
    shift: float = 0.0,
    at_rest: bool = True,
) -> DependentNoise | None:
    """The most significant kind of a record; ``None`` where none is significant or no frequency is free of signal.

    Parameters
    ----------
    residual_v : measured - model (N, S) [V].
    volts : of the model (N, S) [V].
    noise : of the silence.
    signal_hz : highest frequency of the band of the signal [Hz].
    shift : by how many samples the record was advanced.
    at_rest : whether the record starts at rest.
    """
    rate, samples = noise.sample_rate_hz, residual_v.shape[0]
    window = np.ones(samples) if at_rest else np.hanning(samples + 2)[1:-1]
    found = [_find(kind, residual_v, factor_of(kind, volts, rate), noise, signal_hz, shift, window) for kind in COLUMNS]
    return most_significant(one for one in found if one is not None)


def most_significant(found: Iterable[DependentNoise]) -> DependentNoise | None:
    """The most significant of several; ``None`` of none."""
    return max(found, key=lambda one: one.significance, default=None)


def pooled(found: Iterable[DependentNoise]) -> DependentNoise | None:
    """The covariance of several records: the mean of those of the most significant kind, weighted by significance^2."""
    every = list(found)
    best = most_significant(every)
    if best is None:
        return None
    own = [one for one in every if one.kind == best.kind]
    z = np.array([one.significance for one in own])
    mean = np.average([one.covariance for one in own], axis=0, weights=z**2)
    return DependentNoise(best.kind, np.asarray(mean), float(np.linalg.norm(z)))


def _find(
    kind: DependentKind,
    residual_v: FloatArray,
    c: FloatArray,
    noise: NoiseSpectrum,
    signal_hz: float,
    shift: float,
    window: FloatArray,
) -> DependentNoise | None:
    """One kind, with its factor ``c`` (N, S), seen through a ``window`` (N,); arguments as in ``find_dependent_noise``."""
    samples, rate = residual_v.shape[0], noise.sample_rate_hz
    frequency = np.arange(samples // 2 + 1) * rate / samples
    # A quarter of the sample rate leaves half of the noise; above it lie only high harmonics of the signal.
    low = max(rate / 4.0, signal_hz)
    kept = (frequency > low) & (frequency < rate / 2.0)
    if np.count_nonzero(kept) < 100:
        return None
    high = irfft(rfft(residual_v.T * window, axis=1) * kept, n=samples, axis=1)
    sigma2 = np.outer(noise.psd(frequency[kept]).sum(axis=0) * rate / samples, window**2)
    silent_sd = np.sqrt(2.0 / (noise.dof * np.mean(kept))) if noise.white else noise.relative_sd(frequency[kept]).mean()
    width = rate - 2.0 * low
    s = c.T * window
    smooth = np.maximum(width - frequency, 0.0) / rate

    def seen(product: FloatArray) -> FloatArray:
        return np.asarray(irfft(rfft(advanced_products(product, shift)) * smooth, n=samples))

    channels = range(s.shape[0])
    own = [seen(s[a] ** 2) for a in channels]
    t, whole, z = np.zeros((len(channels), len(channels))), [], []
    for a in channels:
        z.append(_significance(high[a], own[a], sigma2[a], width / rate, float(silent_sd)))
        for _ in range(_REWEIGHTED):
            weight = own[a] / (sigma2[a] + t[a, a] * np.maximum(own[a], 0.0)) ** 2
            t[a, a] = max(float(weight @ (high[a] ** 2 - sigma2[a]) / (weight @ own[a])), 0.0)
        whole.append(sigma2[a] + t[a, a] * np.maximum(own[a], 0.0))
    if not max(z) > _SIGNIFICANT:
        return None
    loud = [a for a in channels if z[a] > _SIGNIFICANT]
    if any(
        _kurtosis(high[a] / np.sqrt(np.maximum(whole[a], 1e-3 * whole[a].max())), low, rate) > _RIDGES for a in loud
    ):
        return None
    for a, b in combinations(channels, 2):
        both = seen(s[a] * s[b])
        weight = both / (whole[a] * whole[b])
        limit = np.sqrt(t[a, a] * t[b, b])
        t[a, b] = t[b, a] = float(np.clip(weight @ (high[a] * high[b]) / (weight @ both), -limit, limit))
    return DependentNoise(kind, t, max(z))


def _kurtosis(y: FloatArray, low_hz: float, rate_hz: float) -> float:
    """(excess kurtosis) / sd of the time-frequency coefficients of y (N,) above ``low_hz``; about N(0, 1) for noise.

    The first and the last block, and the lowest two bins, hold what a border cuts.
    """
    size = block_size(y.size)
    inside = bin_frequencies(size, rate_hz) > low_hz + rate_hz / size
    c = lapped(y[:, None], size)[0, 1:-1, inside]
    return float((np.mean(c**4) / np.mean(c**2) ** 2 - 3.0) / np.sqrt(24.0 / c.size)) if c.size else 0.0


def _significance(high: FloatArray, u: FloatArray, sigma2: FloatArray, share: float, silent_sd: float) -> float:
    """(estimate of T) / sd at T = 0; the band has the ``share`` of the samples' degrees of freedom."""
    excess = float(u @ (high**2 - sigma2))
    variance = 2.0 / share * float(np.sum((u * sigma2) ** 2)) + (float(u @ sigma2) * silent_sd) ** 2
    return excess / float(np.sqrt(variance))
