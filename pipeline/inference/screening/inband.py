"""A record in a band of frequencies, with exact transients.

A pole p driven by held samples v from rest, x[n+1] = z x[n] + g v[n], has the discrete Fourier transform (bins w of N samples)

    X(w) = (g(p) V(w) - e^{iw} x_N(p)) / (e^{iw} - z(p)),      x_N = g sum_n z^{N-1-n} v[n]

The end state x_N depends on the pole; a constant x_N would make the sd of the split 39 times larger.  After the filter
G = sum_j r_j/(s - q_j)

    Phi(w; p) = G(p) X(w; p) + sum_j r_j / (q_j - p) X(w; q_j)

so that a model H = sum_k R_k/(s - p_k) + conj gives  Y(w) = sum_k R_k Phi(w; p_k) + conj(R_k) Phi(w; conj p_k)  in the band.
``features`` gives Phi and its Taylor coefficients in p, Phi(p + h) = sum_m Phi_m h^m.

With first-order hold, g v[n] becomes g0 v[n] + g1 v[n+1], with g0 and g1 of each pole.

Shapes: W bins, D drives, M Taylor orders.  Units: rad/s, volts.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import comb

import numpy as np
from numba import njit
from scipy.fft import rfft

from ...arrays import ComplexArray, FloatArray, IntArray
from ...errors import ConfigError
from ...experiment.antialias import filter_poles, filter_response
from ...experiment.instrument import AntiAlias, Instrument

#: Longest record that is treated as a whole, and whose parts are kept for the next device [samples]: 26 s at 10 kHz.  Longer
#: ones are treated in parts where that saves memory, at the cost of time.
SHORT = 2**18
#: Samples of a block of the end sums.
_BLOCK = 256


@dataclass(frozen=True, eq=False)
class Band:
    """The bins of a record between two frequencies, and the parts of the likelihood that depend on the drive alone.

    Parameters
    ----------
    sample_rate_hz, samples : of the record [Hz, 1].
    bins, e_iw : (W,) indices of the bins, and e^{iw}.
    drive_v : (N, D) [V].
    now, following : (D, W) transforms of v[n] and v[n+1] [V].
    antialias, first_order_hold : of the instrument.
    q, filter_part : poles of the filter (order,) [rad/s], and r_j X(w; q_j), (order, D, W).
    """

    sample_rate_hz: float
    samples: int
    bins: IntArray
    e_iw: ComplexArray
    drive_v: FloatArray
    now: ComplexArray
    following: ComplexArray
    antialias: AntiAlias | None
    first_order_hold: bool
    q: ComplexArray
    filter_part: ComplexArray

    @property
    def frequency_hz(self) -> FloatArray:
        """Frequencies of the bins (W,) [Hz]."""
        return self.bins * self.sample_rate_hz / self.samples

    def transform(self, y: FloatArray) -> ComplexArray:
        """sum_n y[n] exp(-i w n) (C, W) [V] of a record y (N, C) [V] at the bins of the band."""
        return transformed(y, self.bins)


def transformed(y: FloatArray, bins: IntArray) -> ComplexArray:
    """sum_n y[n] exp(-i w n) (C, W) [V] of a record y (N, C) [V] at some bins."""
    if y.shape[0] <= SHORT:
        return np.ascontiguousarray(rfft(y.T, axis=-1)[:, bins])
    # One channel after the other: the transform of all is as large as the record.
    out = np.empty((y.shape[1], bins.size), dtype=np.complex128)
    for one, column in zip(out, y.T):
        one[:] = rfft(np.ascontiguousarray(column))[bins]
    return out


def make_band(drive_v: FloatArray, instrument: Instrument, low_hz: float, high_hz: float) -> Band:
    """The band [low, high] Hz of records that ``drive_v`` (N, D) [V] drives.

    Raises
    ------
    ConfigError : hold "bandlimited", which has no closed form, or a band without a bin.
    """
    if instrument.hold == "bandlimited":
        raise ConfigError(
            "the in-band likelihood has no closed form for this hold",
            value=instrument.hold,
            allowed="zoh, foh",
            next_step="interpolate the drive samples to a higher rate and declare foh",
        )
    samples = drive_v.shape[0]
    resolution = instrument.sample_rate_hz / samples
    bins = np.arange(int(np.ceil(low_hz / resolution - 1e-9)), int(np.floor(high_hz / resolution + 1e-9)) + 1)
    bins = bins[(bins > 0) & (bins <= samples // 2)]
    if bins.size == 0:
        raise ConfigError("no frequency bin in the band", value=[low_hz, high_hz], allowed=f"above {resolution:.3g} Hz")
    e_iw = np.exp(2j * np.pi * bins / samples)
    now = transformed(drive_v, bins)
    following = transformed(np.concatenate([drive_v[1:], drive_v[-1:]]), bins)
    bare = Band(
        instrument.sample_rate_hz,
        samples,
        bins,
        e_iw,
        np.ascontiguousarray(drive_v),
        now,
        following,
        None,
        instrument.hold == "foh",
        np.zeros(0, dtype=np.complex128),
        np.zeros((0, drive_v.shape[1], bins.size), dtype=np.complex128),
    )
    if instrument.antialias is None:
        return bare
    q, r = filter_poles(instrument.antialias)
    part = np.stack([r[j] * features(bare, q[j], 0)[0] for j in range(q.size)])
    return Band(
        bare.sample_rate_hz,
        samples,
        bins,
        e_iw,
        bare.drive_v,
        now,
        following,
        instrument.antialias,
        bare.first_order_hold,
        q,
        part,
    )


def _end_sums(drive: FloatArray, log_z: complex, orders: int) -> ComplexArray:
    """sum_n ((N-1-n))^m / m! z^{N-1-n} v[n], (M, D): Taylor coefficients of the end sum in log z, for v (N, D).

    N-1-n = B i + k:  z^{B i} sum_l C(m, l) (B i)^{m-l} sum_k k^l z^k v, so that the sum over k < B is a matrix product.
    """
    samples, drives = drive.shape
    power, k = np.arange(orders), np.arange(_BLOCK)
    table = np.exp(log_z * k)[:, None] * k[:, None] ** power
    real_table = np.concatenate([table.real, table.imag], axis=1)
    sums = np.zeros((orders, drives), dtype=np.complex128)
    # A long record in parts, so that its reversed copy stays small.
    for first in range(0, samples, SHORT):
        if log_z.real * first < -60.0:
            break
        own = drive[max(samples - first - SHORT, 0) : samples - first][::-1]
        blocks = -(-own.shape[0] // _BLOCK)
        reversed_drive = np.zeros((drives, blocks * _BLOCK))
        reversed_drive[:, : own.shape[0]] = own.T
        inner = reversed_drive.reshape(drives * blocks, _BLOCK) @ real_table
        inner_sums = (inner[:, :orders] + 1j * inner[:, orders:]).reshape(drives, blocks, orders)
        shift = float(first) + _BLOCK * np.arange(blocks)
        weighted = inner_sums * np.exp(log_z * shift)[:, None]
        for m in range(orders):
            for l in range(m + 1):
                sums[m] += comb(m, l) * (weighted[:, :, l] @ shift ** (m - l))
    return np.asarray(sums / np.cumprod(np.maximum(power, 1))[:, None])


@njit(cache=True)
def _quotient(
    e_iw: ComplexArray, top: ComplexArray, z_series: ComplexArray, ends: ComplexArray, gain: ComplexArray
) -> ComplexArray:
    """Taylor coefficients (M, D, W) of gain(h) (V - e^{iw} s(h)) / (e^{iw} - z(h)); all series in h."""
    orders, drives = ends.shape
    width = e_iw.size
    out = np.empty((orders, drives, width), dtype=np.complex128)
    inverse = np.empty(orders, dtype=np.complex128)
    for w in range(width):
        e = e_iw[w]
        inverse[0] = 1.0 / (e - z_series[0])
        for m in range(1, orders):
            total = 0j
            for l in range(1, m + 1):
                total += z_series[l] * inverse[m - l]
            inverse[m] = total * inverse[0]
        for d in range(drives):
            for m in range(orders):
                total = top[d, w] * inverse[m]
                for l in range(m + 1):
                    total -= e * ends[l, d] * inverse[m - l]
                out[m, d, w] = total
            for m in range(orders - 1, -1, -1):
                total = 0j
                for l in range(m + 1):
                    total += gain[l] * out[m - l, d, w]
                out[m, d, w] = total
    return out


def _exp_series(argument: complex, step: float, orders: int) -> ComplexArray:
    """Taylor coefficients in h of exp(argument + step h)."""
    m = np.arange(orders)
    factorial = np.cumprod(np.maximum(m, 1))
    return np.asarray(np.exp(argument) * step**m / factorial)


def _divide(series: ComplexArray, pole: complex) -> ComplexArray:
    """Taylor coefficients of series(h) / (pole + h)."""
    out = np.empty_like(series)
    previous = 0j
    for m in range(series.size):
        previous = (series[m] - previous) / pole
        out[m] = previous
    return out


def end_states(band: Band, pole: complex, order: int) -> ComplexArray:
    """Taylor coefficients in the shift of ``pole`` [rad/s] of sum_n z^{N-1-n} v[n], (I, M, D) [V].

    I is 1 for zero-order hold; with first-order hold the second is that of v[n+1].  That of the conjugate pole is the conjugate.
    """
    step = 1.0 / band.sample_rate_hz
    drives = [band.drive_v]
    if band.first_order_hold:
        drives.append(np.ascontiguousarray(np.concatenate([band.drive_v[1:], band.drive_v[-1:]])))
    scaling = step ** np.arange(order + 1)
    return np.stack([_end_sums(drive, complex(pole * step), order + 1) for drive in drives]) * scaling[:, None]


def _free_features(band: Band, pole: complex, orders: int, ends: ComplexArray) -> ComplexArray:
    """X(w; p) and its Taylor coefficients, (M, D, W), without the filter, from the ``end_states`` of the pole."""
    step = 1.0 / band.sample_rate_hz
    z = _exp_series(pole * step, step, orders)
    minus_one = z.copy()
    minus_one[0] = np.expm1(pole * step)
    integrates = pole == 0.0  # the filter's own pole, which is never expanded
    whole = np.full(1, step + 0j) if integrates else _divide(minus_one, pole)
    if not band.first_order_hold:
        return _quotient(band.e_iw, band.now, z, ends[0], whole)
    linear = minus_one.copy()
    linear[0] -= pole * step
    if orders > 1:
        linear[1] -= step
    g1 = np.full(1, step / 2.0 + 0j) if integrates else _divide(_divide(linear, pole), pole) / step
    first = _quotient(band.e_iw, band.now, z, ends[0], whole - g1)
    return first + _quotient(band.e_iw, band.following, z, ends[1], g1)


def features(band: Band, pole: complex, order: int, ends: ComplexArray | None = None) -> ComplexArray:
    """Taylor coefficients Phi_m(w; p), m = 0..order, of the response to a pole of unit residue, (order + 1, D, W).

    Parameters
    ----------
    band : bins and drive.
    pole : p [rad/s].
    order : highest power of the shift of the pole.
    ends : its ``end_states``, which a pole and its conjugate share; computed if left out.
    """
    orders = order + 1
    free = _free_features(band, pole, orders, end_states(band, pole, order) if ends is None else ends)
    if band.antialias is None:
        return free
    # G(p + h) as a Taylor series: G = prod -q_j / (p - q_j), and r_j/(q_j - p - h) term by term.
    gain = np.zeros(orders, dtype=np.complex128)
    gain[0] = filter_response(band.antialias, np.array(pole))[()]
    sums = [np.sum(-1.0 / (pole - band.q) ** (m + 1) * (-1.0) ** m) for m in range(orders)]
    for m in range(1, orders):
        gain[m] = sum(gain[m - 1 - l] * sums[l] for l in range(m)) / m
    shift = np.subtract.outer(np.arange(orders), np.arange(orders))
    series = np.where(shift >= 0, gain[np.abs(shift)], 0.0)
    weights = 1.0 / (band.q - pole) ** np.arange(1, orders + 1)[:, None]
    out = series @ free.reshape(orders, -1) + weights @ band.filter_part.reshape(band.q.size, -1)
    return np.asarray(out.reshape(free.shape))
