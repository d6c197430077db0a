"""Noise of a record in its band that is not white, and its covariance in the compressed likelihood.

The compressed data of channel a are  d_a = Q^T y_a  (see ``compressed``), linear in the samples n_a(t) of the noise.  Coloured
stationary noise is independent between bins; noise that depends on the signal is independent between samples:

    cov(d_a, d_b) = Q^T diag(s_a(w)^2) Q [a = b]  +  sum_t g(t) g(t)^T v_ab(t)

s_a(w)     sd per sample of white noise with the density at the bin w [V]
v_ab(t)    covariance of the noise of channels a and b at time t that depends on the signal [V^2]
g(t)       response of d to the sample t: the columns of Q, transformed back to time

The sum over t runs on a grid of M >= 4 f_high T points, which is exact: g is in the band and v below twice its upper end.  With
the covariance of all channels D = U U^T, U upper triangular, the whitened likelihood is  |U^-1 (d - T c)|^2.

Shapes: S = 2 senses, W bins, r rows of Q's triangle, M grid points.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft
from scipy.linalg import cholesky, solve_triangular

from ...arrays import FloatArray
from ...experiment.noise.spectrum import NoiseSpectrum
from .inband import Band


@dataclass(frozen=True, eq=False)
class BandNoise:
    """Noise of a record in its band.

    Parameters
    ----------
    variance : s^2 (S, W) [V^2] of the stationary noise at each bin.
    relative_sd : (S,) of its mean over the band.
    dependent : v (3, M) [V^2] of the channel pairs (0, 0), (0, 1), (1, 1) over the record; M = 0 without such noise.
    """

    variance: FloatArray
    relative_sd: FloatArray
    dependent: FloatArray

    @property
    def dependent_mean(self) -> FloatArray:
        """Mean over time (S,) [V^2] of the noise that depends on the signal."""
        return self.dependent[[0, 2]].mean(axis=1) if self.dependent.size else np.zeros(2)

    @property
    def unevenness(self) -> FloatArray:
        """mean v^2 / mean^2 (S,) [1] of the whole noise over time: 1 for stationary noise; scales the variance of chi2."""
        if not self.dependent.size:
            return np.ones(2)
        whole = self.variance.mean(axis=1)[:, None] + self.dependent[[0, 2]]
        return np.asarray(np.mean(whole**2, axis=1) / np.mean(whole, axis=1) ** 2)


def band_noise(spectrum: NoiseSpectrum, band: Band) -> BandNoise | None:
    """Stationary noise with the measured ``spectrum``; ``None`` where it is white."""
    if spectrum.white:
        return None
    f = band.frequency_hz
    return BandNoise(spectrum.psd(f).T * spectrum.sample_rate_hz / 2.0, spectrum.relative_sd(f).mean(axis=0), _NONE)


def white_noise(sigma_v: FloatArray, band: Band) -> BandNoise:
    """White noise of sd ``sigma_v`` (S,) [V]."""
    return BandNoise(np.repeat(sigma_v[:, None] ** 2, band.bins.size, axis=1), np.zeros(sigma_v.size), _NONE)


_NONE: FloatArray = np.zeros((3, 0))


def grid_size(band: Band) -> int:
    """M: the points over the record that resolve a product of two signals of the band and one below twice its upper end."""
    return min(next_fast_len(4 * int(band.bins[-1]) + 2), band.samples)


def on_grid(v: FloatArray, band: Band) -> FloatArray:
    """v (P, N) on the M points of the grid, without its content above the grid's Nyquist frequency."""
    size = grid_size(band)
    return np.asarray(irfft(rfft(v, axis=-1)[:, : size // 2 + 1], n=size, axis=-1) * (size / band.samples))


def covariance(rows: FloatArray, band: Band, noise: BandNoise) -> FloatArray:
    """Covariance (3, r, r) [V^2] of Q^T y for the channel pairs (0, 0), (0, 1), (1, 1); ``rows`` is Q (2 W, r) of the record."""
    size = rows.shape[1]
    out = np.zeros((3, size, size))
    for a, pair in ((0, 0), (1, 2)):
        out[pair] = (rows.T * np.tile(noise.variance[a], 2)) @ rows
    points = noise.dependent.shape[1]
    if points:
        # d = sqrt(2/N) sum_w (q_re Re Y + q_im Im Y),  Y = sum_t y e^{-iwt}.
        width = band.bins.size
        spectrum = np.zeros((size, points // 2 + 1), dtype=np.complex128)
        spectrum[:, band.bins] = (rows[:width] + 1j * rows[width:]).T
        g = irfft(spectrum, n=points, axis=1) * (points / 2.0) * np.sqrt(2.0 / band.samples)
        for pair in range(3):
            out[pair] += (g * noise.dependent[pair]) @ g.T * (band.samples / points)
    return out


def rest_chi2(rest: FloatArray, noise: BandNoise, nuisances: int) -> tuple[FloatArray, float]:
    """chi2 (S,) of what Q leaves, (2 W, S) [V], and the variance of the whole chi2, rows of Q included.

    The variance is that of the noise, plus that of its measured level; ``nuisances`` rows were projected out.
    """
    level = np.tile(noise.variance, 2) + noise.dependent_mean[:, None]
    rows = rest.shape[0] - nuisances
    share = noise.variance.mean(axis=1) / level.mean(axis=1)
    variance = 2.0 * rows * noise.unevenness + (rows * share * noise.relative_sd) ** 2
    return np.sum(rest**2 / level.T, axis=0), float(variance.sum())


def whiten(pairs: FloatArray, triangle: FloatArray, data: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The whitened likelihood: triangles (S, r, J), cross triangle (r, J) or (0, J), data (S, r).

    With D = [[D00, D01], [D10, D11]] = U U^T, the residuals are  e1 = U11^-1 (d1 - T c1)  and
    e0 = U00^-1 (d0 - T c0 - U01 e1).

    Parameters
    ----------
    pairs : covariance (3, r, r) [V^2].
    triangle, data : T (r, J) [V per unit of c] and Q^T y (r, S) [V].

    Raises
    ------
    numpy.linalg.LinAlgError : the covariance is not positive definite.
    """
    d00, d01, d11 = pairs
    u11 = _upper(d11)
    t1, e1 = _solve(u11, triangle), _solve(u11, data[:, 1])
    if not d01.any():
        u00 = _upper(d00)
        return (
            np.stack([_solve(u00, triangle), t1]),
            np.zeros((0, triangle.shape[1])),
            np.stack([_solve(u00, data[:, 0]), e1]),
        )
    u01 = _solve(u11, d01.T).T
    u00 = _upper(d00 - u01 @ u01.T)
    t0, cross = _solve(u00, triangle), -_solve(u00, u01 @ t1)
    return np.stack([t0, t1]), cross, np.stack([_solve(u00, data[:, 0] - u01 @ e1), e1])


def _upper(d: FloatArray) -> FloatArray:
    """U, upper triangular, with U U^T = D."""
    return np.asarray(cholesky(d[::-1, ::-1], lower=True)[::-1, ::-1])


def _solve(u: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(solve_triangular(u, b))
