"""Terms of harmonic balance as arrays over all rows: residual, Jacobian, and the tone that a pick-off shows.

    q(t) = Re sum_h Q_h e^{i h w t},   Q_h = a_h - i b_h               x: a_0, a_1, b_1, a_2, b_2, .. of each coordinate
    R_h  = (K - h^2 w^2 + i h w (C + G)) Q_h - F_h,   F_h = 2/T sum_t f e^{-i h theta_t}      (half of it for the mean)

Shapes: N rows, T times of a period, n coordinates, D drives, S senses, H harmonics, m = n (2 H + 1) unknowns.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...arrays import ComplexArray, FloatArray
from ...device.force_law import Points, force_along
from .response import force_volts
from .system import System
from .tones import acting_drive, linear_pickoff

#: Harmonics H and times T of a period: a cubic force of harmonics up to 3 has harmonics up to 9, which do not alias with 32.
HARMONICS, TIMES = 3, 32
_THETA = 2.0 * np.pi * np.arange(TIMES) / TIMES
#: (2 H + 1, T): 1, cos(theta), sin(theta), cos(2 theta), ..
SHAPES: FloatArray = np.ascontiguousarray(
    [np.ones(TIMES), *(turn(h * _THETA) for h in range(1, HARMONICS + 1) for turn in (np.cos, np.sin))]
)
#: (2 H + 1, T): the projection on them.
_WEIGHTS: FloatArray = SHAPES * (np.where(np.arange(2 * HARMONICS + 1) == 0, 1.0, 2.0) / TIMES)[:, None]
#: Difference of a coordinate, relative to the largest one, for the slope of a force.
_SLOPE = 1e-6


@dataclass(frozen=True, eq=False)
class TonePoints:
    """The rows of one record: frequency (N,) [Hz], drive amplitudes (N, D) [V] and times (N,) [s]."""

    frequency_hz: FloatArray
    drive_v: ComplexArray
    time_s: FloatArray

    @property
    def omega(self) -> FloatArray:
        """(N,) [rad/s]."""
        return 2.0 * np.pi * self.frequency_hz


def force_samples(system: System, points: TonePoints) -> FloatArray:
    """u (N, T, D) [V]: the drives at the times of a period, after the drive stage."""
    acting = acting_drive(system, points.frequency_hz, points.drive_v)
    volts = np.real(acting[:, None, :] * np.exp(1.0j * _THETA)[None, :, None])
    count, _, drives = volts.shape
    return np.ascontiguousarray(force_volts(system, volts.reshape(-1, drives)).reshape(count, TIMES, drives))


def _dynamic(system: System, points: TonePoints, h: int) -> ComplexArray:
    """K - h^2 w^2 + i h w (C + G) (N, n, n)."""
    m, w = system.mechanics, h * points.omega[:, None, None]
    return np.asarray(
        m.stiffness[0] - w**2 * np.eye(m.stiffness.shape[1]) + 1.0j * w * (m.damping[0] + m.gyroscopic[0])
    )


def linear_state(system: System, points: TonePoints) -> FloatArray:
    """x (N, m) without nonlinear forces; a nonlinear drive stage drives harmonics."""
    volts = force_samples(system, points) @ system.mechanics.drive[0].T
    n = volts.shape[2]
    x = np.zeros((points.omega.size, n, SHAPES.shape[0]))
    for h in range(HARMONICS + 1):
        if h != 1 and not system.drives:
            continue
        force = np.einsum("t,nti->ni", (2.0 if h else 1.0) / TIMES * np.exp(-1.0j * h * _THETA), volts)
        q = np.linalg.solve(_dynamic(system, points, h), force[:, :, None])[:, :, 0]
        if h == 0:
            x[:, :, 0] = q.real
        else:
            x[:, :, 2 * h - 1], x[:, :, 2 * h] = q.real, -q.imag
    return x.reshape(points.omega.size, -1)


def _in_time(points: TonePoints, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """q and q' (n, N T) at the times of a period."""
    count, terms = points.omega.size, SHAPES.shape[0]
    each = x.reshape(count, -1, terms)
    q, qd = (np.moveaxis(one @ SHAPES, 1, 0).reshape(each.shape[1], -1) for one in (each, _rates(points, each)))
    return np.ascontiguousarray(q), np.ascontiguousarray(qd)


def _rates(points: TonePoints, each: FloatArray) -> FloatArray:
    """Coefficients (N, n, 2 H + 1) of the time derivative of a motion with the coefficients ``each``."""
    rates = np.zeros_like(each)
    for h in range(1, HARMONICS + 1):
        rates[:, :, 2 * h - 1] = h * points.omega[:, None] * each[:, :, 2 * h]
        rates[:, :, 2 * h] = -h * points.omega[:, None] * each[:, :, 2 * h - 1]
    return rates


def _forces(system: System, at: Points) -> FloatArray:
    """Sum of the force laws (n, N T) [V/s]."""
    total = np.zeros(at.q.shape)
    for effect, p in system.forces:
        assert effect.force is not None
        total += force_along(effect.force, at, p, system.laws)
    return total


def _at(system: System, points: TonePoints, x: FloatArray) -> Points:
    q, qd = _in_time(points, x)
    u = force_samples(system, points).reshape(-1, points.drive_v.shape[1]).T
    return Points(np.repeat(points.time_s, TIMES), q, qd, np.ascontiguousarray(u))


def residual_of(system: System, points: TonePoints, x: FloatArray) -> FloatArray:
    """R (N, m)."""
    at, m = _at(system, points, x), system.mechanics
    count, n = points.omega.size, at.q.shape[0]
    force = _forces(system, at) + m.drive[0] @ at.u
    projected = (force.reshape(-1, TIMES) @ _WEIGHTS.T).reshape(n, count, -1)
    out = np.ascontiguousarray(-np.moveaxis(projected, 0, 1))
    each, damping = x.reshape(count, n, -1), m.damping[0] + m.gyroscopic[0]
    out += np.moveaxis(np.moveaxis(each, 1, 2) @ m.stiffness[0].T, 2, 1)
    for h in range(1, HARMONICS + 1):
        w, a, b = h * points.omega[:, None], each[:, :, 2 * h - 1], each[:, :, 2 * h]
        out[:, :, 2 * h - 1] += w * (b @ damping.T) - w**2 * a
        out[:, :, 2 * h] -= w * (a @ damping.T) + w**2 * b
    return out.reshape(count, -1)


def jacobian_of(system: System, points: TonePoints, x: FloatArray) -> FloatArray:
    """dR/dx (N, m, m)."""
    at = _at(system, points, x)
    count, n, terms = points.omega.size, at.q.shape[0], SHAPES.shape[0]
    out = np.zeros((count, n, terms, n, terms))
    for h in range(HARMONICS + 1):
        z = _dynamic(system, points, h)
        if h == 0:
            out[:, :, 0, :, 0] = z.real
            continue
        a, b = 2 * h - 1, 2 * h
        out[:, :, a, :, a], out[:, :, b, :, b] = z.real, z.real
        out[:, :, a, :, b], out[:, :, b, :, a] = z.imag, -z.imag
    if system.forces:
        plain = _forces(system, at)
        largest = np.repeat(np.abs(x).max(axis=1), TIMES)
        order = np.array([(k + 1) // 2 for k in range(terms)])
        # d q'/d x: h w b cos - h w a sin.
        partner = np.array([0, *(k + 1 if k % 2 else k - 1 for k in range(1, terms))])
        sign = np.array([0.0, *(-1.0 if k % 2 else 1.0 for k in range(1, terms))])
        slopes_of_rate = (order * sign)[:, None] * SHAPES[partner]
        for j in range(n):
            for rate in (False, True):
                step = _SLOPE * np.where(largest > 0.0, largest, 1.0)
                step = step * np.repeat(points.omega, TIMES) if rate else step
                change = np.zeros(at.q.shape)
                change[j] = step
                zero = np.zeros(at.q.shape)
                moved = _forces(system, at.plus(*((zero, change) if rate else (change, zero))))
                slope = ((moved - plain) / step).reshape(n, count, TIMES)
                shapes = slopes_of_rate if rate else SHAPES
                part = np.einsum("rt,int,ct->nirc", _WEIGHTS, slope, shapes, optimize=True)
                out[:, :, :, j, :] -= part * points.omega[:, None, None, None] if rate else part
    return out.reshape(count, n * terms, n * terms)


def pickoff_tones(system: System, points: TonePoints, x: FloatArray) -> ComplexArray:
    """S (N, S) [V]: the tone in the pick-off volts of a motion x (N, m), with the sense effects."""
    m, each = system.mechanics, x.reshape(points.omega.size, -1, SHAPES.shape[0])
    if not system.senses:
        return linear_pickoff(system, points.omega / (2.0 * np.pi), each[:, :, 1] - 1.0j * each[:, :, 2])
    q_t, v_t = (one.T for one in _in_time(points, x))
    s = v_t @ m.velocity_sense[0].T + q_t @ m.position_sense[0].T
    if m.senses_acceleration:
        _, a_t = _in_time(points, _rates(points, each))
        s = s + a_t.T @ m.acceleration_sense[0].T
    t = np.repeat(points.time_s, TIMES)
    for effect, p in system.senses:
        assert effect.sense is not None
        s = effect.sense(q_t @ system.sense_motion.T, v_t @ system.sense_motion.T, s, t, p, system.context)
    tone = np.einsum("t,nts->ns", 2.0 / TIMES * np.exp(-1.0j * _THETA), s.reshape(points.omega.size, TIMES, -1))
    return np.asarray(tone)
