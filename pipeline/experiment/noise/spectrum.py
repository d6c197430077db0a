"""Power spectral density of the noise, measured on silence, with its uncertainty.

Sine multitapers give K independent periodograms from one transform of twice the length (Riedel and Sidorenko, IEEE Trans. Signal
Process. 43 (1995) 188).  Their average over the n bins of a band b has the relative sd 1/sqrt(n), so for y_b = ln of that average

    y_b = g_b + e_b,     var e_b = c / n_b,     c = 1 + 1/(2K), the loss by the tapers
    g_b - g_{b-1} ~ N(0, a w_b^2),  w_b = ln(f_b / f_{b-1}) / 0.12:  the logarithm of the density is a random walk in ln f

Bands have an equal width of 0.12 in ln(1 + f/f0), so w is 1 above f0 and grows below.  (With w = 1 everywhere the density of 1/f
noise was 0.3 to 0.5 of the true one at 7 Hz, and one campaign of ten was "unknown" for a line there.)  The mean and sd of g given
y are the estimate.  The step variance a is that of the largest likelihood; a = 0 is white noise.
White noise is kept unless the score test of a = 0 rejects it, so that a white record has one sigma from all its samples.

Shapes: N samples, S senses, B bands, F frequencies.  The density is one-sided [V^2/Hz]: white noise has 2 sigma^2 / f_s.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.fft import rfft
from scipy.linalg import cho_solve
from scipy.special import digamma, gammaincc

from ...arrays import BoolArray, FloatArray, IntArray
from ..instrument import Adc
from .lines import silent_dof, silent_residual, with_quantisation

#: Tapers: c = 1.125, and leakage falls fast enough for noise that grows as 1/f^2.
_TAPERS = 4
_LOSS = 1.0 + 1.0 / (2.0 * _TAPERS)
#: Width of a band in ln(1 + f/f0): AR(0.7) noise changes by at most 14 % of its density within a band.
_STEP = 0.12
#: Bins in the lowest band; ln of their average has a sd of 0.37, close enough to normal.
_LEAST_BINS = 8
#: Shorter silence [samples] counts as white: it has fewer than four bands.
_SHORTEST = 128
#: False-alarm probability of the test for colour, per channel.
_ALPHA = 1e-3
#: A bin this many times above the median of its band is a line (false-alarm probability 1e-9 per bin with four tapers).
_LINE = 8.0
#: Candidates of the step variance a: from a change of 5 % over 30 bands to one of a factor 4 between neighbours.
_STEP_VARIANCES = np.geomspace(1e-4, 2.0, 15)


@dataclass(frozen=True, eq=False)
class NoiseSpectrum:
    """The density of the noise of each channel.

    Parameters
    ----------
    sample_rate_hz : f_s [Hz].
    sigma_v : (S,) standard deviation per sample [V] of the silence, lines and trend removed.
    dof : degrees of freedom of sigma^2, as if white.
    frequency_hz : (B,) centres of the bands; (0,) if all channels are white.
    log_density, log_sd : (B, S) ln of the density [V^2/Hz], and its sd (the relative sd of the density).
    corner_hz : f0 of the bands [Hz].
    """

    sample_rate_hz: float
    sigma_v: FloatArray
    dof: int
    frequency_hz: FloatArray
    log_density: FloatArray
    log_sd: FloatArray
    corner_hz: float

    @property
    def white(self) -> bool:
        """Whether no channel shows a colour."""
        return self.frequency_hz.size == 0

    @property
    def low_hz(self) -> float:
        """Lowest frequency [Hz] at which the density was measured; 0 where it is white."""
        return 0.0 if self.white else float(self.frequency_hz[0])

    def psd(self, f_hz: FloatArray) -> FloatArray:
        """The density (F, S) [V^2/Hz] at ``f_hz`` (F,); constant outside the bands."""
        f = np.asarray(f_hz, dtype=np.float64)
        if self.white:
            return np.broadcast_to(2.0 * self.sigma_v**2 / self.sample_rate_hz, (f.size, self.sigma_v.size)).copy()
        return np.exp(self._between(self.log_density, f))

    def relative_sd(self, f_hz: FloatArray) -> FloatArray:
        """Relative sd (F, S) [1] of the density at ``f_hz`` (F,)."""
        f = np.asarray(f_hz, dtype=np.float64)
        if self.white:
            return np.full((f.size, self.sigma_v.size), np.sqrt(2.0 / self.dof))
        return self._between(self.log_sd, f)

    def sigma_at(self, f_hz: FloatArray) -> FloatArray:
        """sd per sample (F, S) [V] of white noise that has the density at ``f_hz`` (F,): what whitens a bin."""
        return np.sqrt(self.psd(f_hz) * self.sample_rate_hz / 2.0)

    def _between(self, values: FloatArray, f: FloatArray) -> FloatArray:
        u, at = np.log1p(self.frequency_hz / self.corner_hz), np.log1p(f / self.corner_hz)
        return np.stack([np.interp(at, u, own) for own in values.T], axis=1)


def white_spectrum(sigma_v: FloatArray, sample_rate_hz: float, dof: int) -> NoiseSpectrum:
    """White noise of sd ``sigma_v`` (S,) [V] per sample, known with ``dof`` degrees of freedom."""
    none = np.zeros((0, sigma_v.size))
    return NoiseSpectrum(sample_rate_hz, sigma_v, dof, np.zeros(0), none, none, 1.0)


@dataclass(frozen=True, eq=False)
class _Bands:
    """Bands of the bins 0 .. N/2: ``first`` (B,) bin of each, ``used`` (N/2 + 1,) bins, ``bins`` (B,) used ones in each.

    ``corner`` is f0 in bins; ``walk`` (B, B) is the covariance of the random walk from the first band, in units of a.  The score
    of a = 0 is a quadratic form in sqrt(n) (y - mean); ``score`` (B, B) is its matrix, ``shape`` and ``scale`` are those of the
    gamma distribution with its mean and variance under white noise.
    """

    first: IntArray
    used: BoolArray
    bins: FloatArray
    corner: float
    walk: FloatArray
    score: FloatArray
    shape: float
    scale: float


@lru_cache(maxsize=8)
def _bands(samples: int, line_bins: float | None) -> _Bands:
    """Bands of records of ``samples``; the harmonics of ``line_bins`` [bins], and the trend, are left out."""
    highest = samples // 2
    corner = _LEAST_BINS / np.expm1(_STEP)
    lowest = _TAPERS // 2 + 1
    k = np.arange(highest + 1)
    used = (k >= lowest) & (k < highest - _TAPERS // 2)
    if line_bins is not None:
        nearest = np.maximum(np.rint(k / line_bins), 1.0) * line_bins
        used &= np.abs(k - nearest) > (_TAPERS + 1) / 2.0
    count = max(2, int(np.log1p(highest / corner) / _STEP))
    edges = corner * np.expm1(np.linspace(np.log1p(lowest / corner), np.log1p(highest / corner), count + 1))
    first = np.unique(np.maximum(np.rint(edges[:-1]).astype(np.int64), lowest))
    bins = np.add.reduceat(used.astype(np.float64), first)
    first, bins = first[bins > 0.0], bins[bins > 0.0]
    centre = (first + np.append(first[1:], highest)) / 2.0
    passed = np.concatenate([[0.0], np.cumsum((np.diff(np.log(centre)) / _STEP) ** 2)])
    # The test takes equal steps: cov(g_i, g_j) = a min(i, j).  Its matrix is the part orthogonal to a constant, in units of e.
    root = np.sqrt(bins / _LOSS)
    walk = np.minimum.outer(np.arange(bins.size), np.arange(bins.size)).astype(np.float64)
    constant = root / np.linalg.norm(root)
    free = np.eye(bins.size) - np.outer(constant, constant)
    score = free @ (root[:, None] * walk * root) @ free
    mean, variance = float(np.trace(score)), 2.0 * float(np.sum(score**2))
    return _Bands(
        first, used, bins, float(corner), np.minimum.outer(passed, passed), score, mean**2 / variance, variance / mean
    )


def _periodogram(y: FloatArray, sample_rate_hz: float) -> FloatArray:
    """Mean of K tapered periodograms (N/2 + 1, S) [V^2/Hz] of y (N, S).

    The taper sin(pi k (n + 1/2) / N) shifts the transform of length 2N by k bins to either side.
    """
    samples = y.shape[0]
    wide = rfft(y.T, n=2 * samples, axis=1)
    padded = np.concatenate([wide[:, _TAPERS:0:-1].conj(), wide, wide[:, -2 : -2 - _TAPERS : -1].conj()], axis=1)
    end = 2 * (samples // 2) + 1
    total = np.zeros((y.shape[1], samples // 2 + 1))
    for k in range(1, _TAPERS + 1):
        turn = np.exp(1j * np.pi * k / samples)
        below, above = _TAPERS - k, _TAPERS + k
        difference = padded[:, below : below + end : 2] * turn - padded[:, above : above + end : 2]
        total += difference.real**2 + difference.imag**2
    # |taper|^2 sums to N/2, and the difference is 2i times the tapered transform.
    return total.T / (samples * sample_rate_hz * _TAPERS)


def _log_average(power: FloatArray, used: BoolArray, bands: _Bands) -> tuple[FloatArray, FloatArray]:
    """Unbiased ln of the average of power (N/2 + 1,) over the used bins of each band (B,), and their numbers (B,)."""
    bins = np.add.reduceat(used.astype(np.float64), bands.first)
    average = np.add.reduceat(power * used, bands.first) / bins
    effective = bins / _LOSS
    return np.log(np.maximum(average, 1e-300)) - (digamma(effective) - np.log(effective)), bins


def _coloured(y: FloatArray, bins: FloatArray, bands: _Bands) -> bool:
    """Whether the score test rejects a constant ln density, given estimates y (B,)."""
    root = np.sqrt(bins / _LOSS)
    z = root * (y - np.sum(bins * y) / np.sum(bins))
    return bool(gammaincc(bands.shape, z @ bands.score @ z / bands.scale) < _ALPHA)


def _without_line_bins(power: FloatArray, bands: _Bands) -> BoolArray:
    """The used bins (N/2 + 1,) without those of narrow lines, which stand out of the median of their band."""
    line = np.zeros(power.size, dtype=np.bool_)
    for first, end in zip(bands.first, np.append(bands.first[1:], power.size)):
        own = power[first:end]
        line[first:end] = own > _LINE * np.median(own[bands.used[first:end]])
    kept = bands.used & ~(np.convolve(line, np.ones(_TAPERS + 1), mode="same") > 0.5)
    return kept if np.all(np.add.reduceat(kept.astype(np.float64), bands.first) > 0.0) else bands.used


def _walk_posterior(y: FloatArray, bins: FloatArray, walk: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean and sd (B,) of the random walk g of covariance a ``walk`` (B, B) given y (B,), at the most likely a."""
    noise = np.diag(_LOSS / bins)
    best: tuple[float, FloatArray, FloatArray] | None = None
    for a in _STEP_VARIANCES:
        # 1e4: an unknown level of the walk.
        prior = a * walk + 1e4
        factor = np.linalg.cholesky(prior + noise)
        centred = y - y.mean()
        weighted = cho_solve((factor, True), centred)
        likelihood = -0.5 * float(centred @ weighted) - float(np.sum(np.log(np.diag(factor))))
        if best is None or likelihood > best[0]:
            covariance = prior - prior @ cho_solve((factor, True), prior)
            best = likelihood, y.mean() + prior @ weighted, np.sqrt(np.maximum(np.diag(covariance), 0.0))
    assert best is not None
    return best[1], best[2]


def noise_spectrum(
    silence: FloatArray, rate_hz: float, line_hz: float | None = None, adc: Adc | None = None
) -> NoiseSpectrum:
    """The spectrum of the noise of a silent record.

    Parameters
    ----------
    silence : (N, S) [V].
    rate_hz : f_s [Hz].
    line_hz : mains frequency [Hz] whose harmonics are removed.
    adc : where silence does not exercise it, LSB^2/12 is added as white noise.
    """
    samples, senses = silence.shape
    rest, variance = silent_residual(silence, rate_hz, line_hz)
    whole = with_quantisation(variance, adc)
    sigma_v, dof = np.sqrt(whole), silent_dof(samples, rate_hz, line_hz)
    if samples < _SHORTEST or not np.all(variance > 0.0):
        return white_spectrum(sigma_v, rate_hz, dof)
    power = _periodogram(rest, rate_hz)
    bands = _bands(samples, None if line_hz is None else line_hz * samples / rate_hz)
    if not any(_coloured(*_log_average(own, bands.used, bands), bands) for own in power.T):
        return white_spectrum(sigma_v, rate_hz, dof)
    # A line alone looks like colour; the second test, and the variance, are without it.
    used = [_without_line_bins(own, bands) for own in power.T]
    variance = np.array([np.mean(own[kept]) for own, kept in zip(power.T, used)]) * rate_hz / 2.0
    whole = with_quantisation(variance, adc)
    averages = [_log_average(own, kept, bands) for own, kept in zip(power.T, used)]
    colour = [_coloured(*average, bands) for average in averages]
    if not any(colour):
        return white_spectrum(np.sqrt(whole), rate_hz, dof)
    log_density = np.tile(np.log(2.0 * variance / rate_hz), (bands.bins.size, 1))
    log_sd = np.full((bands.bins.size, senses), np.sqrt(2.0 / dof))
    for s in np.flatnonzero(colour):
        log_density[:, s], log_sd[:, s] = _walk_posterior(*averages[s], bands.walk)
    density = np.exp(log_density) + 2.0 * (whole - variance) / rate_hz
    resolution = rate_hz / samples
    last = np.append(bands.first[1:], samples // 2)
    centre = (bands.first + last) / 2.0 * resolution
    return NoiseSpectrum(rate_hz, sigma_v, dof, centre, np.log(density), log_sd, bands.corner * resolution)
