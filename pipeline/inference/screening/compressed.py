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
x: cartesian parameters (12,) of ``pipeline.device.gyro``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.linalg import qr

from ...arrays import ComplexArray, FloatArray
from ...device.gyro import cartesian_modes
from .inband import Band, features
from .whitening import BandNoise, covariance, rest_chi2, white_noise, whiten

ORDER = 3
_ORDERS = ORDER + 1
_FEATURES = 3 * 2 * _ORDERS * 2
#: Steps of the central differences of c(x): rad/s and 1/s, then logarithms and imbalances.
_STEPS: FloatArray = np.array([1e-4] * 8 + [1e-5] * 4)


@dataclass(frozen=True, eq=False)
class Compressed:
    """The likelihood of one device around the poles ``expansion`` (3,) [rad/s].

    triangle (S, r, J) is T and data (S, r) is Q^T y of each channel, in sigmas.  cross (r, J) is what the second channel's
    coefficients add to the first channel's residual where the noise of both is correlated; (0, J) otherwise.  rest_chi2 (S,) is
    |y - Q Q^T y|^2; ``rows`` is the number of real data, and ``chi2_sd`` the sd of chi2 at the
    truth, ``None`` for white noise.
    """

    expansion: ComplexArray
    triangle: FloatArray
    cross: FloatArray
    data: FloatArray
    rest_chi2: FloatArray
    rows: int
    chi2_sd: float | None


def _columns(band: Band, expansion: ComplexArray) -> FloatArray:
    """Features as real columns (2 W, J)."""
    width = band.bins.size
    out = np.empty((3, 2, _ORDERS, 2, 2, width))
    for k in range(3):
        plus = np.swapaxes(features(band, complex(expansion[k]), ORDER), 0, 1)
        minus = np.swapaxes(features(band, complex(np.conj(expansion[k])), ORDER), 0, 1)
        real, imag = plus + minus, 1j * (plus - minus)
        out[k, :, :, 0, 0], out[k, :, :, 0, 1] = real.real, real.imag
        out[k, :, :, 1, 0], out[k, :, :, 1, 1] = imag.real, imag.imag
    return out.reshape(_FEATURES, 2 * width).T


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


def nuisance_basis(band: Band, line_hz: float | None) -> FloatArray:
    """Orthonormal basis (2 W, L) [1] of hum lines (harmonics of ``line_hz`` [Hz]) in the band; L = 0 without hum."""
    if line_hz is None:
        return np.zeros((2 * band.bins.size, 0))
    frequency = band.frequency_hz
    low, high = frequency[0] - line_hz / 2.0, frequency[-1] + line_hz / 2.0
    lines = line_hz * np.arange(max(1, math.ceil(low / line_hz)), math.floor(high / line_hz) + 1)
    t = np.arange(band.samples) / band.sample_rate_hz
    angle = 2.0 * np.pi * t[:, None] * lines
    columns = _stacked(band.transform(np.concatenate([np.cos(angle), np.sin(angle)], axis=1)))
    left, size, _ = np.linalg.svd(columns, full_matrices=False)
    return np.ascontiguousarray(left[:, size > 1e-6 * np.sqrt(band.samples)])


def compress(records: Sequence[BandData], sigma_v: FloatArray, expansion: ComplexArray) -> Compressed:
    """Compress all ``records`` of a device around the poles ``expansion`` (3,) [rad/s].

    Parameters
    ----------
    records : one or more, of the same device.
    sigma_v : sd (S,) [V] of a sample, of the records whose noise is white.
    expansion : centre p0 of the Taylor series.

    Raises
    ------
    numpy.linalg.LinAlgError : the covariance of the noise is not positive definite.
    """
    blocks: list[FloatArray] = []
    targets: list[FloatArray] = []
    for record in records:
        scale = math.sqrt(2.0 / record.band.samples)
        a = _columns(record.band, expansion) * scale
        y = _stacked(record.spectrum) * scale
        n = record.nuisance
        if n.shape[1]:
            a, y = a - n @ (n.T @ a), y - n @ (n.T @ y)
        blocks.append(a)
        targets.append(y)
    rows = sum(a.shape[0] - record.nuisance.shape[1] for a, record in zip(blocks, records))
    if all(record.noise is None for record in records):
        y = np.concatenate(targets) / sigma_v
        q, triangle = qr(np.concatenate(blocks), mode="economic", overwrite_a=True, check_finite=False)
        data = q.T @ y
        rest = np.maximum(np.sum(y**2, axis=0) - np.sum(data**2, axis=0), 0.0)
        scaled = np.ascontiguousarray(triangle / sigma_v[:, None, None])
        none = np.zeros((0, triangle.shape[1]))
        return Compressed(expansion, scaled, none, np.ascontiguousarray(data.T), rest, 2 * rows, math.sqrt(4.0 * rows))
    noises = [record.noise or white_noise(sigma_v, record.band) for record in records]
    y = np.concatenate(targets)
    q, triangle = (
        np.asarray(part, dtype=np.float64)
        for part in qr(np.concatenate(blocks), mode="economic", overwrite_a=True, check_finite=False)
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
        2 * rows,
        math.sqrt(variance),
    )


@njit(cache=True)
def _coefficients(x: FloatArray, expansion: ComplexArray, out: FloatArray, shift: FloatArray) -> None:
    """c(x) as (S, J) real numbers, and |h_k| in ``shift`` (3,)."""
    poles = np.empty(3, dtype=np.complex128)
    residues = np.empty((3, 2, 2), dtype=np.complex128)
    cartesian_modes(x, poles, residues)
    crossed = abs(poles[0] - expansion[1]) + abs(poles[1] - expansion[0])
    straight = abs(poles[0] - expansion[0]) + abs(poles[1] - expansion[1])
    for k in range(3):
        source = k
        if crossed < straight and k < 2:
            source = 1 - k
        h = poles[source] - expansion[k]
        shift[k] = abs(h)
        for a in range(2):
            for d in range(2):
                c = residues[source, a, d]
                for m in range(_ORDERS):
                    j = ((k * 2 + d) * _ORDERS + m) * 2
                    out[a, j] = c.real
                    out[a, j + 1] = c.imag
                    c = c * h


@njit(cache=True)
def _triangle_times(triangle: FloatArray, c: FloatArray, out: FloatArray) -> None:
    rows, columns = triangle.shape
    for i in range(rows):
        total = 0.0
        for j in range(i, columns):
            total += triangle[i, j] * c[j]
        out[i] = total


@njit(cache=True)
def allowed(x: FloatArray) -> bool:
    """Support of the prior at x (12,) [rad/s, 1/s, 1]: C positive semidefinite, up-down mode damped, imbalances below 1."""
    return bool(
        x[3] > 0.0
        and x[4] * x[4] + x[5] * x[5] <= x[3] * x[3]
        and x[7] > 0.0
        and 4.0 * x[6] * x[6] > x[7] * x[7]
        and abs(x[10]) < 1.0
        and abs(x[11]) < 1.0
        and x[0] * x[0] > x[1] * x[1] + x[2] * x[2]
        and x[6] > 0.0
    )


@njit(cache=True)
def _model_rows(c: FloatArray, triangle: FloatArray, cross: FloatArray, out: FloatArray) -> None:
    """T c (2 r,) in sigmas from coefficients c (2, J)."""
    rows = triangle.shape[1]
    for a in range(2):
        _triangle_times(triangle[a], c[a], out[a * rows : (a + 1) * rows])
    for i in range(cross.shape[0]):
        for j in range(cross.shape[1]):
            out[i] += cross[i, j] * c[1, j]


@njit(cache=True)
def residual_rows(
    x: FloatArray, expansion: ComplexArray, triangle: FloatArray, cross: FloatArray, data: FloatArray
) -> tuple[FloatArray, float]:
    """Residuals data - model (2 r,) in sigmas at x (12,), and the largest |h| [rad/s]."""
    rows = triangle.shape[1]
    c = np.empty((2, _FEATURES))
    shift = np.empty(3)
    _coefficients(x, expansion, c, shift)
    out = np.empty(2 * rows)
    _model_rows(c, triangle, cross, out)
    for a in range(2):
        for i in range(rows):
            out[a * rows + i] = data[a, i] - out[a * rows + i]
    return out, float(shift.max())


@njit(cache=True)
def jacobian_rows(x: FloatArray, expansion: ComplexArray, triangle: FloatArray, cross: FloatArray) -> FloatArray:
    """d model / d x (2 r, 12), in sigmas per unit of x (12,), by central differences of c(x)."""
    rows = triangle.shape[1]
    size = x.size
    c_plus = np.empty((2, _FEATURES))
    c_minus = np.empty((2, _FEATURES))
    shift = np.empty(3)
    out = np.empty((2 * rows, size))
    column = np.empty(2 * rows)
    for i in range(size):
        moved = x.copy()
        moved[i] = x[i] + _STEPS[i]
        _coefficients(moved, expansion, c_plus, shift)
        moved[i] = x[i] - _STEPS[i]
        _coefficients(moved, expansion, c_minus, shift)
        _model_rows((c_plus - c_minus) / (2.0 * _STEPS[i]), triangle, cross, column)
        out[:, i] = column
    return out


@njit(cache=True)
def log_likelihood(
    points: FloatArray, expansion: ComplexArray, triangle: FloatArray, cross: FloatArray, data: FloatArray
) -> FloatArray:
    """-chi2/2 (n,) [1] of the compressed part at ``points`` (n, 12), -inf outside the support of the prior."""
    count = points.shape[0]
    rows = triangle.shape[1]
    c = np.zeros((count, 2, _FEATURES))
    shift = np.empty(3)
    inside = np.empty(count, dtype=np.bool_)
    for n in range(count):
        inside[n] = allowed(points[n])
        if inside[n]:
            _coefficients(points[n], expansion, c[n], shift)
    first, second = np.ascontiguousarray(c[:, 0]), np.ascontiguousarray(c[:, 1])
    model = np.empty((2, count, rows))
    model[0] = np.dot(first, triangle[0].T)
    model[1] = np.dot(second, triangle[1].T)
    if cross.shape[0]:
        model[0] += np.dot(second, cross.T)
    out = np.empty(count)
    for n in range(count):
        total = 0.0
        for a in range(2):
            for i in range(rows):
                r = data[a, i] - model[a, n, i]
                total += r * r
        out[n] = -0.5 * total if inside[n] else -np.inf
    return out
