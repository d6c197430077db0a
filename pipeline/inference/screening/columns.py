"""Features of the compressed likelihood as real columns: Phi_m(w; p) of the three poles and of their conjugates (``inband``).

With u = 1 / (e^{iw} - z(p)), the response to held samples behind the filter is a polynomial in u for each power h^m of the shift
of a pole:

    X(h) = g(h) (V - e^{iw} x(h)) / (e^{iw} - z(h)) = sum_i (z(h) - z)^i u^{i+1} g(h) (V - e^{iw} x(h)),     e^{iw} = z + 1/u
    Phi_m = [h^m] X(h) + sum_j r_j X(w; q_j) / (q_j - p)^{m+1}

g is the gain of the hold times that of the filter, x the end state; with first-order hold there are two such terms.
Complex numbers are pairs of real ones inside of the loop over the bins: numba writes no vectors for complex numbers.

Shapes: 3 modes, D = 2 drives, M = ORDER + 1 powers, W bins, I terms of the hold.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from ...arrays import ComplexArray, FloatArray
from ...experiment.antialias import filter_response
from .end_sums import block_sums, end_sums, reversed_blocks
from .inband import SHORT, Band, following_drive
from .kept import kept_if_short
from .likelihood import FEATURES, ORDER

_ORDERS = ORDER + 1
#: Options of functions that only compiled loops call.
_INSIDE: dict[str, Any] = {"cache": True, "no_cpython_wrapper": True}


def feature_columns(band: Band, expansion: ComplexArray) -> FloatArray:
    """Features A (2 W, J) [V per unit of c] around the poles ``expansion`` (3,) [rad/s], in columns of memory."""
    step = 1.0 / band.sample_rate_hz
    argument = expansion * step
    gain = np.zeros((3, _ORDERS), dtype=np.complex128)
    gain[:, 0] = 1.0
    if band.antialias is None:
        out = np.zeros((3, 2, _ORDERS, 2, 2, band.bins.size))
    else:
        gain[:, 0] = filter_response(band.antialias, expansion)
        _multiply_filter(gain, band.q - expansion[:, None])
        # Straight into the rows of the features: the part of the filter is as large as they are.
        part = _filter_weights(band.q, expansion)[:, None] @ _filter_rows(band)
        out = part.reshape(3, 2, _ORDERS, 2, 2, -1)
    ends = _end_states(band, expansion)
    tops = np.stack([band.now, band.following]) if band.first_order_hold else band.now[None]
    _add_free(
        band.e_iw,
        tops,
        expansion,
        np.exp(argument),
        np.expm1(argument),
        np.expm1(argument) - argument,
        gain,
        ends,
        step,
        out,
    )
    return out.reshape(FEATURES, -1).T


@kept_if_short(4)
def _filter_rows(band: Band) -> FloatArray:
    """Real and imaginary parts (D, 2 order, W) of the poles of the filter, which all devices of a band share."""
    return np.ascontiguousarray(np.concatenate([band.filter_part.real, band.filter_part.imag]).transpose(1, 0, 2))


def _filter_weights(q: ComplexArray, poles: ComplexArray) -> FloatArray:
    """What ``_filter_rows`` adds to the features (M, re/im of c, re/im) of each pole (3,), (3, 4 M, 2 order)."""
    inverse = 1.0 / (q - np.stack([poles, poles.conj()])[:, :, None])
    own, other = np.cumprod(np.repeat(inverse[:, :, None], _ORDERS, axis=2), axis=2)
    both = np.stack([own + other, 1j * (own - other)], axis=2)
    real = np.concatenate([both.real, -both.imag], axis=3)
    imag = np.concatenate([both.imag, both.real], axis=3)
    return np.stack([real, imag], axis=3).reshape(poles.size, 4 * _ORDERS, -1)


@kept_if_short(4)
def _shared_blocks(band: Band) -> FloatArray:
    """Reversed blocks of the drive, and of the following drive with first-order hold, which all devices of a band share."""
    drives = [band.drive_v, following_drive(band.drive_v)] if band.first_order_hold else [band.drive_v]
    return reversed_blocks(np.concatenate(drives, axis=1))


def _end_states(band: Band, poles: ComplexArray) -> ComplexArray:
    """Taylor coefficients in the shift of ``poles`` (3,) [rad/s] of sum_n z^{N-1-n} v[n], (3, I, M, D) [V].

    I is 1 for zero-order hold; with first-order hold the second is that of v[n+1].  That of the conjugate pole is the conjugate.
    """
    step = 1.0 / band.sample_rate_hz
    log_z, scaling = poles * step, step ** np.arange(_ORDERS)
    if band.samples <= SHORT:
        sums = block_sums(_shared_blocks(band), log_z, _ORDERS)
    else:
        drives = [band.drive_v, following_drive(band.drive_v)] if band.first_order_hold else [band.drive_v]
        sums = np.concatenate([end_sums(drive, log_z, _ORDERS, SHORT) for drive in drives], axis=2)
    by_term = sums.reshape(3, _ORDERS, -1, band.drive_v.shape[1]).transpose(0, 2, 1, 3)
    return np.ascontiguousarray(by_term * scaling[:, None])


@njit(cache=True)
def _multiply_filter(gain: ComplexArray, distances: ComplexArray) -> None:
    """Taylor coefficients (3, M) of G(p + h), in place of G(p) in gain[:, 0], for ``distances`` q_j - p (3, order)."""
    orders = gain.shape[1]
    for k in range(gain.shape[0]):
        # G'/G = sum_j 1 / (q_j - p)
        sums = np.zeros(orders, dtype=np.complex128)
        for j in range(distances.shape[1]):
            one = 1.0 / distances[k, j]
            power = one
            for m in range(orders):
                sums[m] += power
                power = power * one
        for m in range(1, orders):
            total = 0j
            for l in range(m):
                total += gain[k, m - 1 - l] * sums[l]
            gain[k, m] = total / m


@njit(**_INSIDE)
def _divided(series: ComplexArray, pole: complex, out: ComplexArray) -> None:
    """Fill ``out`` with the Taylor coefficients of series(h) / (pole + h); it may be ``series``."""
    previous = 0j
    for m in range(_ORDERS):
        previous = (series[m] - previous) / pole
        out[m] = previous


@njit(**_INSIDE)
def _product(one: ComplexArray, other: ComplexArray, out: ComplexArray) -> None:
    """Fill ``out`` with the Taylor coefficients of a product."""
    for m in range(_ORDERS):
        out[m] = 0.0
        for l in range(m + 1):
            out[m] += one[l] * other[m - l]


@njit(cache=True, error_model="numpy", fastmath={"contract", "nsz"})
def _add_polynomial(
    u: FloatArray,
    v: FloatArray,
    a: ComplexArray,
    c: ComplexArray,
    b: complex,
    sign: float,
    real: FloatArray,
    imag: FloatArray,
) -> None:
    """Add X = sum_i u^{i+1} (a_i v + c_i) - b (W,) to ``real`` (2, W), and i X times ``sign`` to ``imag`` (2, W), ORDER = 3."""
    a0r, a0i, a1r, a1i = a[0].real, a[0].imag, a[1].real, a[1].imag
    a2r, a2i, a3r, a3i = a[2].real, a[2].imag, a[3].real, a[3].imag
    c0r, c0i, c1r, c1i = c[0].real, c[0].imag, c[1].real, c[1].imag
    c2r, c2i, c3r, c3i = c[2].real, c[2].imag, c[3].real, c[3].imag
    br, bi = b.real, b.imag
    for w in range(u.shape[1]):
        ur, ui, vr, vi = u[0, w], u[1, w], v[0, w], v[1, w]
        sr, si = a3r * vr - a3i * vi + c3r, a3r * vi + a3i * vr + c3i
        tr, ti = sr * ur - si * ui, sr * ui + si * ur
        sr, si = tr + a2r * vr - a2i * vi + c2r, ti + a2r * vi + a2i * vr + c2i
        tr, ti = sr * ur - si * ui, sr * ui + si * ur
        sr, si = tr + a1r * vr - a1i * vi + c1r, ti + a1r * vi + a1i * vr + c1i
        tr, ti = sr * ur - si * ui, sr * ui + si * ur
        sr, si = tr + a0r * vr - a0i * vi + c0r, ti + a0r * vi + a0i * vr + c0i
        tr, ti = sr * ur - si * ui - br, sr * ui + si * ur - bi
        real[0, w] += tr
        real[1, w] += ti
        imag[0, w] -= sign * ti
        imag[1, w] += sign * tr


@njit(cache=True)
def _add_free(
    e_iw: ComplexArray,
    tops: ComplexArray,
    poles: ComplexArray,
    z: ComplexArray,
    minus_one: ComplexArray,
    minus_two: ComplexArray,
    filter_gain: ComplexArray,
    ends: ComplexArray,
    step: float,
    out: FloatArray,
) -> None:
    """Add the terms of the device's own poles to ``out`` (3, D, M, re/im of c, re/im, W).

    e_iw (W,), tops (I, D, W), poles (3,), z = e^{pT}, z - 1, z - 1 - pT (3,), filter_gain (3, M), ends (3, I, M, D).
    """
    count = e_iw.size
    u, v = np.empty((2, count)), np.empty((2, count))
    # One array, filled element by element: numba compiles each kind of allocation anew, and an assignment of an array with the
    # text of its errors, which takes a second.
    work = np.empty((10 + _ORDERS, _ORDERS + 1), dtype=np.complex128)
    series, moved, gain, end, driven, a, b, c = work[0], work[1], work[2], work[3], work[4], work[5], work[6], work[7]
    gains, powers = work[8:10], work[10:]
    b[_ORDERS] = 0.0
    for k in range(3):
        factor = z[k]
        for m in range(_ORDERS):
            series[m], moved[m] = factor, factor
            factor = factor * step / (m + 1)
        series[0], moved[0] = minus_one[k], 0.0
        _divided(series, poles[k], gains[0])
        if tops.shape[0] == 2:
            series[0] = minus_two[k]
            series[1] -= step
            _divided(series, poles[k], gains[1])
            _divided(gains[1], poles[k], gains[1])
            for m in range(_ORDERS):
                gains[1, m] /= step
                gains[0, m] -= gains[1, m]
        for term in range(tops.shape[0]):
            _product(gains[term], filter_gain[k], gain)
            # (z(h) - z)^i
            for m in range(_ORDERS):
                powers[0, m] = 1.0 if m == 0 else 0.0
            for i in range(1, _ORDERS):
                _product(powers[i - 1], moved, powers[i])
            for conjugate in range(2):
                own = z[k].conjugate() if conjugate else z[k]
                for w in range(count):
                    one = 1.0 / (e_iw[w] - own)
                    u[0, w], u[1, w] = one.real, one.imag
                for d in range(tops.shape[1]):
                    for w in range(count):
                        v[0, w], v[1, w] = tops[term, d, w].real, tops[term, d, w].imag
                    for m in range(_ORDERS):
                        end[m] = ends[k, term, m, d]
                    _product(gain, end, driven)
                    for m in range(_ORDERS):
                        for i in range(_ORDERS):
                            top, last = 0j, 0j
                            for l in range(m + 1):
                                top += gain[l] * powers[i, m - l]
                                last += driven[l] * powers[i, m - l]
                            a[i] = top.conjugate() if conjugate else top
                            b[i] = last.conjugate() if conjugate else last
                        for i in range(_ORDERS):
                            c[i] = -own * b[i] - b[i + 1]
                        _add_polynomial(u, v, a, c, b[0], -1.0 if conjugate else 1.0, out[k, d, m, 0], out[k, d, m, 1])
