"""Modes of many devices with cartesian parameters at once: ``gyro.cartesian_modes`` in vectors of the processor.

The rocking poles are roots of det P(s), P(s) = s^2 I + s C + K, by Newton's method with known roots divided out:

    s <- s - f / (f' - f sum_q 1/(s - q)),     f = det P(s)

The first takes four steps from the slow flow, with the conjugate of its start as q; the second takes three, with the first as q.
A point whose last step was not small is computed alone: a fixed number of steps lets points share a vector.

The points are the last axis, so that neighbours are neighbours in memory.  Complex numbers are pairs of real ones: numba writes
no vectors for complex numbers.  With the error model of numpy a division does not end the loop.

Shapes: n points.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from ..arrays import FloatArray
from .gyro import M_D, M_S, cartesian_modes

#: Largest last step relative to the distance of the poles: the error left is its square, 1e-14 of the distance.
_LAST = 1e-7
#: Distance of poles [rad/s] below which they are moved apart, by the code for one device.
_APART = 1e-6


@njit(cache=True, error_model="numpy", fastmath={"contract", "nsz"})
def _newton(
    pr: float,
    pi: float,
    qr: float,
    qi: float,
    kxx: float,
    kxy: float,
    kyy: float,
    cxx: float,
    cxy: float,
    cyy: float,
) -> tuple[float, float]:
    """Step (re, im) from the pole p with the root q divided out."""
    sr, si = pr * pr - pi * pi, 2.0 * pr * pi
    ar, ai = sr + pr * cxx + kxx, si + pi * cxx
    br, bi = pr * cxy + kxy, pi * cxy
    cr, ci = sr + pr * cyy + kyy, si + pi * cyy
    vr = ar * cr - ai * ci - br * br + bi * bi
    vi = ar * ci + ai * cr - 2.0 * br * bi
    er, ei = 2.0 * pr + cxx, 2.0 * pi
    gr, gi = 2.0 * pr + cyy, 2.0 * pi
    dr = er * cr - ei * ci + ar * gr - ai * gi - 2.0 * br * cxy
    di = er * ci + ei * cr + ar * gi + ai * gr - 2.0 * bi * cxy
    ur, ui = pr - qr, pi - qi
    size = 1.0 / (ur * ur + ui * ui)
    dr -= (vr * ur + vi * ui) * size
    di -= (vi * ur - vr * ui) * size
    size = 1.0 / (dr * dr + di * di)
    return (vr * dr + vi * di) * size, (vi * dr - vr * di) * size


@njit(cache=True, error_model="numpy", fastmath={"contract", "nsz"})
def _rocking_poles(x: FloatArray, poles: FloatArray, last: FloatArray) -> None:
    """Fill poles[:2] (2, re/im, n) of x (P, n) [rad/s], and ``last`` (n,) with |last steps|^2 / |distance|^2."""
    for n in range(x.shape[1]):
        omega0, eps_c, eps_s, c0, d_c, d_s = x[0, n], x[1, n], x[2, n], x[3, n], x[4, n], x[5, n]
        kxx, kyy, kxy = omega0 * (omega0 + eps_c), omega0 * (omega0 - eps_c), omega0 * eps_s
        cxx, cyy, cxy = c0 + d_c, c0 - d_c, d_s
        # root = sqrt(m_c^2 + m_s^2) with the positive real part.
        square_r = 0.25 * (d_c * d_c - eps_c * eps_c + d_s * d_s - eps_s * eps_s)
        square_i = -0.5 * (eps_c * d_c + eps_s * d_s)
        size = math.sqrt(square_r * square_r + square_i * square_i)
        root_r = math.sqrt(abs(0.5 * (size + square_r)))
        root_i = math.sqrt(abs(0.5 * (size - square_r)))
        root_i = -root_i if square_i < 0.0 else root_i
        pr, pi = -0.5 * c0 - root_r, omega0 - root_i
        own_r, own_i = pr, -pi
        # Written out: a loop of steps would take ten times as long, because it is not done in vectors.
        br, bi = _newton(pr, pi, own_r, own_i, kxx, kxy, kyy, cxx, cxy, cyy)
        pr, pi = pr - br, pi - bi
        br, bi = _newton(pr, pi, own_r, own_i, kxx, kxy, kyy, cxx, cxy, cyy)
        pr, pi = pr - br, pi - bi
        br, bi = _newton(pr, pi, own_r, own_i, kxx, kxy, kyy, cxx, cxy, cyy)
        pr, pi = pr - br, pi - bi
        br, bi = _newton(pr, pi, own_r, own_i, kxx, kxy, kyy, cxx, cxy, cyy)
        pr, pi = pr - br, pi - bi
        qr, qi = -0.5 * c0 + root_r, omega0 + root_i
        gr, gi = _newton(qr, qi, pr, pi, kxx, kxy, kyy, cxx, cxy, cyy)
        qr, qi = qr - gr, qi - gi
        gr, gi = _newton(qr, qi, pr, pi, kxx, kxy, kyy, cxx, cxy, cyy)
        qr, qi = qr - gr, qi - gi
        gr, gi = _newton(qr, qi, pr, pi, kxx, kxy, kyy, cxx, cxy, cyy)
        qr, qi = qr - gr, qi - gi
        apart = (pr - qr) * (pr - qr) + (pi - qi) * (pi - qi)
        step = (br * br + bi * bi + gr * gr + gi * gi) / apart
        last[n] = math.inf if apart < _APART * _APART else step
        # The pole of the smaller frequency first.
        swap = pi > qi
        poles[0, 0, n], poles[1, 0, n] = qr if swap else pr, pr if swap else qr
        poles[0, 1, n], poles[1, 1, n] = qi if swap else pi, pi if swap else qi


@njit(cache=True, error_model="numpy", fastmath={"contract", "nsz"})
def _residues(x: FloatArray, gains: FloatArray, poles: FloatArray, residues: FloatArray) -> None:
    """Fill residues (3, 2, 2, re/im, n) and poles[2] of x (P, n) with gains (2, n) = exp(x[8:10])."""
    with_mismatch = x.shape[0] == 14
    for k in range(2):
        for n in range(x.shape[1]):
            omega0, eps_c, eps_s, c0, d_c, d_s = x[0, n], x[1, n], x[2, n], x[3, n], x[4, n], x[5, n]
            pr, pi, qr, qi = poles[k, 0, n], poles[k, 1, n], poles[1 - k, 0, n], poles[1 - k, 1, n]
            sr, si = pr * pr - pi * pi, 2.0 * pr * pi
            ar, ai = sr + pr * (c0 + d_c) + omega0 * (omega0 + eps_c), si + pi * (c0 + d_c)
            br, bi = pr * d_s + omega0 * eps_s, pi * d_s
            cr, ci = sr + pr * (c0 - d_c) + omega0 * (omega0 - eps_c), si + pi * (c0 - d_c)
            # (p - q)(p - conj p)(p - conj q), the slope of det P.
            ur, ui = pr - qr, pi - qi
            vr, vi = -2.0 * pi * (pi + qi), 2.0 * pi * (pr - qr)
            lr, li = ur * vr - ui * vi, ur * vi + ui * vr
            size = gains[0, n] / (lr * lr + li * li)
            hr, hi = (pr * lr + pi * li) * size, (pi * lr - pr * li) * size
            s, d = x[10, n], x[11, n]
            if with_mismatch:
                d += x[12, n]
                s += x[13, n]
            for i in range(2):
                xr, xi = M_S[i, 0] * cr - M_S[i, 1] * br, M_S[i, 0] * ci - M_S[i, 1] * bi
                yr, yi = M_S[i, 1] * ar - M_S[i, 0] * br, M_S[i, 1] * ai - M_S[i, 0] * bi
                k_s = 1.0 + (2 * i - 1) * s
                for j in range(2):
                    factor = k_s * (1.0 + (2 * j - 1) * d)
                    fr, fi = xr * M_D[0, j] + yr * M_D[1, j], xi * M_D[0, j] + yi * M_D[1, j]
                    residues[k, i, j, 0, n] = (hr * fr - hi * fi) * factor
                    residues[k, i, j, 1, n] = (hr * fi + hi * fr) * factor
    for n in range(x.shape[1]):
        pr, pi = -0.5 * x[7, n], math.sqrt(x[6, n] * x[6, n] - 0.25 * x[7, n] * x[7, n])
        poles[2, 0, n], poles[2, 1, n] = pr, pi
        # p / (p - conj p) = 1/2 - i p_r / (2 p_i)
        hr, hi = 0.5 * gains[1, n], -0.5 * gains[1, n] * pr / pi
        for i in range(2):
            for j in range(2):
                factor = (1.0 + (2 * i - 1) * x[10, n]) * (1.0 + (2 * j - 1) * x[11, n])
                residues[2, i, j, 0, n], residues[2, i, j, 1, n] = hr * factor, hi * factor


@njit(cache=True)
def batch_modes(x: FloatArray, gains: FloatArray, poles: FloatArray, residues: FloatArray) -> None:
    """Modes of points x (P, n), P = 12 or 14, as :func:`pipeline.device.gyro.cartesian_modes` gives them for one.

    Parameters
    ----------
    x : cartesian parameters, rows in memory; of devices (|eps| < omega0, damped).
    gains : (2, n) exp(x[8:10]) [1].
    poles, residues : filled with real and imaginary parts, (3, 2, n) [rad/s] and (3, S, D, 2, n) [rad/s].
    """
    last = np.empty(x.shape[1])
    _rocking_poles(x, poles, last)
    _residues(x, gains, poles, residues)
    own_poles, own_residues = np.empty(3, dtype=np.complex128), np.empty((3, 2, 2), dtype=np.complex128)
    for n in range(x.shape[1]):
        # The comparison is false for nan.
        if last[n] <= _LAST * _LAST:
            continue
        cartesian_modes(x[:, n].copy(), own_poles, own_residues)
        for k in range(3):
            poles[k, 0, n], poles[k, 1, n] = own_poles[k].real, own_poles[k].imag
            for i in range(2):
                for j in range(2):
                    residues[k, i, j, 0, n] = own_residues[k, i, j].real
                    residues[k, i, j, 1, n] = own_residues[k, i, j].imag
