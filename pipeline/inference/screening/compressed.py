"""The in-band likelihood of plant "gyro", compressed to a triangular matrix.

In the band a model is linear in  c = R_k h_k^m  (residues times powers of the shift of each pole from an expansion point p0):

    Y_a(w) = sum_{k,d,m} c_{a,k,d,m} Phi_{k,m,d}(w) + conj(c_{a,k,d,m}) Phi~_{k,m,d}(w),     h_k = p_k - p0_k

so with the features in the columns of A (hum lines projected out) and A = Q T,

    chi2 = sum_a (|T c_a - Q^T y_a|^2 + |y_a - Q Q^T y_a|^2) 2 / (N sigma_a^2)

costs a product with one small triangle per call instead of all bins.  Noise that is not white has a covariance D of Q^T y
(``whitening``), whose factor divides triangle and data once, so that it costs nothing per call either.
Third order in h is exact to 2e-8 for |h| < 0.03 rad/s;
a new expansion is made when the poles leave that disc.

Shapes: S = 2 senses, D = 2 drives, 3 modes, M = 4 orders, J = 48 real features (mode, drive, order, re/im), W bins.
x: cartesian parameters (12,) of ``pipeline.device.gyro``, or (14,) with the electrode mismatches (``mismatch``), P in all.
A prior of the mismatches is two more rows of residuals, root m' against offset.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import qr

from ...arrays import ComplexArray, FloatArray
from ...experiment.noise.lines import MOST_HARMONICS
from .columns import feature_columns
from .inband import Band
from .mismatch import MismatchPrior
from .triangle import FeatureRows, triangle_of
from .whitening import BandNoise, covariance, rest_chi2, white_noise, whiten

#: Samples of waves that are transformed at once: 32 lines of the paper's record; all lines of a long one took 18 times its size.
_WAVES = 2**20


@dataclass(frozen=True, eq=False)
class Compressed:
    """The likelihood of one device around the poles ``expansion`` (3,) [rad/s].

    triangle (S, r, J) is T and data (S, r) is Q^T y of each channel, in sigmas.  cross (r, J) is what the second channel's
    coefficients add to the first channel's residual where the noise of both is correlated; (0, J) otherwise.  rest_chi2 (S,) is
    |y - Q Q^T y|^2; ``rows`` is the number of real data, and ``chi2_sd`` the sd of chi2 at the truth, ``None`` for white noise.
    prior_root (2, 2) and prior_offset (2,) [1] are those of the mismatches; (0, 2) and (0,) without.
    columns are the features A (2 W, J) [V per unit of c] of each record.
    """

    expansion: ComplexArray
    triangle: FloatArray
    cross: FloatArray
    data: FloatArray
    rest_chi2: FloatArray
    rows: int
    chi2_sd: float | None
    prior_root: FloatArray
    prior_offset: FloatArray
    columns: tuple[FloatArray, ...]

    @property
    def arrays(self) -> tuple[ComplexArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
        """What the kernels take after x: expansion, triangle, cross, data, prior_root, prior_offset."""
        return self.expansion, self.triangle, self.cross, self.data, self.prior_root, self.prior_offset


def _stacked(spectrum: ComplexArray) -> FloatArray:
    """(S, W) complex as (2 W, S) real."""
    return np.concatenate([spectrum.real, spectrum.imag], axis=-1).T


@dataclass(frozen=True, eq=False)
class BandData:
    """One record in its band: ``spectrum`` (S, W) [V] of the senses, and an orthonormal ``nuisance`` basis (2 W, L) [1].

    ``noise`` is its noise where that is not white.
    """

    band: Band
    spectrum: ComplexArray
    nuisance: FloatArray
    noise: BandNoise | None = None


def lines_between(low_hz: float, high_hz: float, line_hz: float) -> FloatArray:
    """The lowest harmonics of ``line_hz`` [Hz] that lie between half a harmonic below a band and half a harmonic above it."""
    low, high = low_hz - line_hz / 2.0, high_hz + line_hz / 2.0
    return np.asarray(
        line_hz * np.arange(max(1, math.ceil(low / line_hz)), min(math.floor(high / line_hz), MOST_HARMONICS) + 1.0)
    )


def line_columns(band: Band, lines_hz: FloatArray) -> FloatArray:
    """Transforms of the cosines of the lines (l,) [Hz], then of their sines, as real columns (2 W, 2 l)."""
    t = np.arange(band.samples) / band.sample_rate_hz
    at_once = max(_WAVES // band.samples, 1)
    out = np.empty((2 * band.bins.size, 2, lines_hz.size))
    for first in range(0, lines_hz.size, at_once):
        own = slice(first, first + at_once)
        angle = 2.0 * np.pi * t[:, None] * lines_hz[own]
        for part, wave in enumerate((np.cos, np.sin)):
            out[:, part, own] = _stacked(band.transform(wave(angle)))
    return out.reshape(out.shape[0], -1)


def nuisance_basis(band: Band, line_hz: float | None) -> FloatArray:
    """Orthonormal basis (2 W, L) [1] of hum lines (harmonics of ``line_hz`` [Hz]) in the band; L = 0 without hum."""
    if line_hz is None:
        return np.zeros((2 * band.bins.size, 0))
    frequency = band.frequency_hz
    lines_hz = lines_between(float(frequency[0]), float(frequency[-1]), line_hz)
    if not lines_hz.size:
        return np.zeros((2 * band.bins.size, 0))
    columns = line_columns(band, lines_hz)
    left, size, _ = np.linalg.svd(columns, full_matrices=False)
    return np.ascontiguousarray(left[:, size > 1e-6 * np.sqrt(band.samples)])


def _part(columns: FloatArray, record: BandData, sigma_v: FloatArray) -> FeatureRows:
    """A record with its features (2 W, J) [V], in units of the noise where that is white; sigma (S,) [V]."""
    return FeatureRows(
        columns, _stacked(record.spectrum) / sigma_v, record.nuisance, math.sqrt(2.0 / record.band.samples)
    )


def compress(
    records: Sequence[BandData], sigma_v: FloatArray, expansion: ComplexArray, prior: MismatchPrior | None = None
) -> Compressed:
    """Compress all ``records`` of a device around the poles ``expansion`` (3,) [rad/s].

    Parameters
    ----------
    records : one or more, of the same device.
    sigma_v : sd (S,) [V] of a sample, of the records whose noise is white.
    expansion : centre p0 of the Taylor series.
    prior : of the mismatches; ``None`` where they are no parameters.

    Raises
    ------
    numpy.linalg.LinAlgError : the covariance of the noise is not positive definite.
    """
    columns = tuple(feature_columns(record.band, expansion) for record in records)
    rows = sum(a.shape[0] - record.nuisance.shape[1] for a, record in zip(columns, records))
    root, offset = (np.zeros((0, 2)), np.zeros(0)) if prior is None else prior.rows()
    real = 2 * rows + offset.size
    if all(record.noise is None for record in records):
        # [A, y] = Q [[T, Q^T y], [0, r]] with |r|^2 = rest.
        corner = triangle_of([_part(own, record, sigma_v) for own, record in zip(columns, records)])
        size = columns[0].shape[1]
        triangle, data, left = corner[:size, :size], corner[:size, size:], corner[size:, size:]
        rest = np.sum(left**2, axis=0)
        scaled = np.ascontiguousarray(triangle / sigma_v[:, None, None])
        none = np.zeros((0, triangle.shape[1]))
        return Compressed(
            expansion, scaled, none, np.ascontiguousarray(data.T), rest, real, None, root, offset, columns
        )
    noises = [record.noise or white_noise(sigma_v, record.band) for record in records]
    blocks = [_part(own, record, np.ones(2)).without_lines() for own, record in zip(columns, records)]
    y = np.concatenate([block[:, -2:] for block in blocks])
    q, triangle = (
        np.asarray(part, dtype=np.float64)
        for part in qr(
            np.concatenate([block[:, :-2] for block in blocks]), mode="economic", overwrite_a=True, check_finite=False
        )
    )
    data = q.T @ y
    left = y - q @ data
    pairs = np.zeros((3, q.shape[1], q.shape[1]))
    rest, variance, first = np.zeros(y.shape[1]), 0.0, 0
    for record, noise, block in zip(records, noises, blocks):
        own = slice(first, first + block.shape[0])
        pairs += covariance(q[own], record.band, noise)
        chi2, spread = rest_chi2(left[own], noise, record.nuisance.shape[1])
        rest, variance, first = rest + chi2, variance + spread, own.stop
    whitened, cross, target = whiten(pairs, triangle, data)
    return Compressed(
        expansion,
        np.ascontiguousarray(whitened),
        np.ascontiguousarray(cross),
        np.ascontiguousarray(target),
        rest,
        real,
        math.sqrt(variance),
        root,
        offset,
        columns,
    )
