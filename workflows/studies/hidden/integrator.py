"""Fixed-step Runge-Kutta integration (order 8) of a device and its signal path as one state vector.

    psi_x, psi_y, z, w      mechanics, with a parasitic mode w: q'' = F f(v, q) - (C(t) + G) q' - K(t) q + nonlinear forces
    m_x, m_y                memory of the suspension (hysteresis, heat)
    b_kj, b_kj'             biquads j = 1..4 of the anti-alias filter of channel k
    h, h_x, h_y             hidden modes of internal resonances 1:2 and 1:3, only where there is one

The drive is held over each sample, so no step crosses an edge of the drive.  A stray capacitance passes the impulse
C (v_n - v_{n-1}), which is a jump of the velocity of the first biquad.  The pick-off pole is applied after the filter
(both are linear): p' = (y - p)/T is solved exactly for the quintic through y, y', y'' at both ends of a step.

No code is shared with the models of ``pipeline``.  Shapes: N samples.  Units: volts, seconds; motion in V s.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from scipy.integrate import DOP853

from pipeline.arrays import FloatArray

from .physics import Physics

#: Coordinates psi_x, psi_y, z, w; two channels of four biquads.
COORDINATES = 4
_MEMORY = 2 * COORDINATES
_FILTER = _MEMORY + 2
STATES = _FILTER + 16
#: States of the hidden modes, behind the others: h, h', h_x, h_x', h_y, h_y'.
HIDDEN = 6

# Dormand and Prince's method of order 8 with 12 stages (Hairer, Norsett & Wanner, Solving ODEs I, section II.5).
_STAGES = 12
_A: FloatArray = np.ascontiguousarray(DOP853.A[:_STAGES, :_STAGES])
_B: FloatArray = np.ascontiguousarray(DOP853.B[:_STAGES])
_C: FloatArray = np.ascontiguousarray(DOP853.C[:_STAGES])


@njit(cache=True)
def size_of(g: Physics) -> int:
    """Number of states."""
    return STATES + HIDDEN if g.hidden[0, 0] != 0.0 or g.hidden[1, 0] != 0.0 else STATES


@njit(cache=True, fastmath={"contract", "reassoc", "nsz"})
def slope(t: float, y: FloatArray, v: FloatArray, g: Physics, dy: FloatArray) -> None:
    """Writes dy/dt of the state y (``size_of``,) at time t [s] with the held drive v (2,) [V] to ``dy``."""
    n = COORDINATES
    charge = g.charging * t
    warm = 1.0 + g.stiffness_drift * t - 2.0 * g.softened_share * charge
    if g.pump != 0.0:
        warm += g.pump * np.cos(g.pump_omega * t)
    if g.step != 0.0:
        warm += 0.5 * g.step * (1.0 + np.tanh((t - g.step_s) / g.step_width_s))
    loss = 1.0 + g.damping_drift * t
    for i in range(n):
        a = 0.0
        for j in range(n):
            a -= warm * g.stiffness[i, j] * y[j] + (loss * g.damping[i, j] + g.gyroscopic[i, j]) * y[n + j]
        dy[i] = y[n + i]
        dy[n + i] = a
    for k in range(2):
        applied = min(max(v[k], -g.swing_v), g.swing_v)
        u = applied + g.square_law * applied * applied / (2.0 * g.bias_v)
        if g.inverse_drive_gap != 0.0:
            closed = 0.0
            for j in range(n):
                closed += g.drive_motion[k, j] * y[j]
            closed *= g.inverse_drive_gap
            half = 0.5 * g.bias_v
            u = (half + u) / ((1.0 - closed) * (1.0 - closed)) - half - g.bias_v * closed
        for i in range(n):
            dy[n + i] += g.drive[i, k] * u * (1.0 + charge)
        dy[n + 2] += g.fringe * g.drive[2, k] * applied * applied / (2.0 * g.bias_v)
    x, z, xd, zd = y[0], y[1], y[n], y[n + 1]
    radius2 = x * x + z * z
    speed = np.sqrt(xd * xd + zd * zd)
    dy[_MEMORY] = dy[_MEMORY + 1] = 0.0
    # Central forces and isotropic dampings.
    pull, drag = g.cubic * radius2, g.drag * speed + g.cubic_drag * speed * speed
    if g.preload != 0.0:
        pull += g.preload / np.sqrt(radius2 + g.preload_reach * g.preload_reach)
    if g.stop != 0.0 and radius2 > g.stop_gap * g.stop_gap:
        pull += g.stop * (1.0 - g.stop_gap / np.sqrt(radius2))
    if g.friction != 0.0:
        drag += g.friction / np.sqrt(speed * speed + g.friction_speed * g.friction_speed)
    dy[n] -= pull * x + g.quadratic_x * x * x + drag * xd
    dy[n + 1] -= pull * z + g.quadratic_y * z * z + drag * zd
    if g.film != 0.0 or g.weakening != 0.0:
        # Films on both sides, whose gaps are 1 - x and 1 + x; both laws without what is in the linear damping.
        x_g = np.sqrt(g.film * radius2)
        change = 0.5 / (1.0 - x_g) ** 3 + 0.5 / (1.0 + x_g) ** 3 - 1.0
        change += 1.0 / (1.0 + g.weakening * speed) - 1.0
        dy[n] -= change * (g.damping[0, 0] * xd + g.damping[0, 1] * zd)
        dy[n + 1] -= change * (g.damping[1, 0] * xd + g.damping[1, 1] * zd)
    if g.hysteresis != 0.0:
        for i in range(2):
            h, s = y[_MEMORY + i], y[n + i]
            dy[_MEMORY + i] = s - 0.5 * (abs(s) * h + s * abs(h)) / g.hysteresis_reach
            dy[n + i] -= g.hysteresis * h
    if g.coupling != 0.0:
        dy[n] -= 2.0 * g.coupling * x * z
        dy[n + 1] -= g.coupling * x * x
    if g.heating != 0.0:
        dy[_MEMORY] = speed * speed - g.cooling_per_s * y[_MEMORY]
        for j in range(2):
            for i in range(2):
                dy[n + i] -= g.heating * y[_MEMORY] * g.stiffness[i, j] * y[j]
    if y.size > STATES:
        _hidden(warm, loss, y, g, dy)
    _read(t, y, v, g, dy)


@njit(cache=True, fastmath={"contract", "reassoc", "nsz"})
def _hidden(warm: float, loss: float, y: FloatArray, g: Physics, dy: FloatArray) -> None:
    """Adds the potentials c h |psi|^2 and c |psi|^2 (h_x psi_x + h_y psi_y); the hidden modes drift as the others."""
    radius2 = y[0] * y[0] + y[1] * y[1]
    double, triple = g.hidden[0, 0], g.hidden[1, 0]
    along = y[STATES + 2] * y[0] + y[STATES + 4] * y[1]
    for k in range(3):
        h = STATES + 2 * k
        c, omega, zeta = g.hidden[min(k, 1)]
        dy[h] = y[h + 1]
        dy[h + 1] = (
            -warm * omega * omega * y[h] - loss * 2.0 * zeta * omega * y[h + 1] - c * radius2 * (y[k - 1] if k else 1.0)
        )
    for i in range(2):
        pull = 2.0 * (double * y[STATES] + triple * along) * y[i] + triple * radius2 * y[STATES + 2 + 2 * i]
        dy[COORDINATES + i] -= pull


@njit(cache=True, fastmath={"contract", "reassoc", "nsz"})
def _read(t: float, y: FloatArray, v: FloatArray, g: Physics, dy: FloatArray) -> None:
    n = COORDINATES
    pickoff = np.empty(2)
    for k in range(2):
        s, closed = 0.0, 0.0
        for j in range(n):
            s += g.sense[k, j] * y[n + j]
            closed += g.sense_motion[k, j] * y[j]
        open_ = 1.0 - g.inverse_sense_gap * closed
        pickoff[k] = s / (open_ * open_) * (1.0 + g.gain_drift * t) * (1.0 + g.charging * t)
        pickoff[k] += g.resistive[k, 0] * v[0] + g.resistive[k, 1] * v[1]
    for k in range(2):
        volts = g.crosstalk[k, 0] * pickoff[0] + g.crosstalk[k, 1] * pickoff[1]
        for j in range(4):
            b = _FILTER + 8 * k + 2 * j
            dy[b] = y[b + 1]
            dy[b + 1] = g.filter_square * (volts - y[b]) - g.filter_damping[j] * y[b + 1]
            volts = y[b]


@njit(cache=True, fastmath={"contract", "reassoc", "nsz"})
def _step(t: float, h: float, y: FloatArray, v: FloatArray, g: Physics, stages: FloatArray, trial: FloatArray) -> None:
    """Advance the state y by one step of length h [s], in place; ``stages`` and ``trial`` are work space."""
    for i in range(_STAGES):
        for k in range(y.size):
            trial[k] = y[k]
        for j in range(i):
            a = h * _A[i, j]
            if a != 0.0:
                for k in range(y.size):
                    trial[k] += a * stages[j, k]
        slope(t + _C[i] * h, trial, v, g, stages[i])
    for j in range(_STAGES):
        b = h * _B[j]
        if b != 0.0:
            for k in range(y.size):
                y[k] += b * stages[j, k]


@njit(cache=True, fastmath={"contract", "reassoc", "nsz"})
def _filtered(y: FloatArray, g: Physics, out: FloatArray) -> None:
    """Writes the filter outputs y, y', y'' of both channels to ``out`` (2, 3)."""
    for k in range(2):
        b = _FILTER + 8 * k + 6
        out[k, 0], out[k, 1] = y[b], y[b + 1]
        out[k, 2] = g.filter_square * (y[b - 2] - y[b]) - g.filter_damping[3] * y[b + 1]


@njit(cache=True, fastmath={"contract", "reassoc", "nsz"})
def lagged(p: float, a: FloatArray, b: FloatArray, h: float, lag: float) -> float:
    """p(h) of lag p' = y - p, p(0) = ``p``; y is the quintic with y, y', y'' = ``a`` (3,) at 0 and ``b`` (3,) at h [s]."""
    # y = sum c_i s^i with s = time / h.
    c = np.empty(6)
    c[0], c[1], c[2] = a[0], a[1] * h, 0.5 * a[2] * h * h
    d0 = b[0] - (c[0] + c[1] + c[2])
    d1 = b[1] * h - (c[1] + 2.0 * c[2])
    d2 = b[2] * h * h - 2.0 * c[2]
    c[3], c[4] = 10.0 * d0 - 4.0 * d1 + 0.5 * d2, -15.0 * d0 + 7.0 * d1 - d2
    c[5] = 6.0 * d0 - 3.0 * d1 + 0.5 * d2
    # The particular solution is a polynomial with e_i = c_i - (lag/h) (i + 1) e_{i+1}.
    e = np.empty(6)
    e[5] = c[5]
    for i in range(4, -1, -1):
        e[i] = c[i] - lag / h * (i + 1) * e[i + 1]
    return e[0] + e[1] + e[2] + e[3] + e[4] + e[5] + np.exp(-h / lag) * (p - e[0])


@njit(cache=True, fastmath={"contract", "reassoc", "nsz"})
def _impulse(v: FloatArray, n: int, g: Physics, y: FloatArray) -> None:
    """Adds the jump that stray capacitances pass at the edge of the drive before sample ``n`` to the state y, in place."""
    for k in range(2):
        jump = 0.0
        for i in range(2):
            for d in range(2):
                was = v[n - 1, d] if n > 0 else 0.0
                jump += g.crosstalk[k, i] * g.capacitive[i, d] * (v[n, d] - was)
        y[_FILTER + 8 * k + 1] += g.filter_square * jump


@njit(cache=True, fastmath={"contract", "reassoc", "nsz"})
def knots(v: FloatArray, sample_s: float, steps: int, g: Physics) -> FloatArray:
    """Filter outputs y, y', y'' [V, V/s, V/s^2] of both channels at both ends of every step, (M, 2 ends, 2, 3), from rest.

    ``steps`` steps per sample of ``sample_s`` [s]; delay and pole of the read-out are not applied.
    """
    out = np.empty((v.shape[0] * steps, 2, 2, 3))
    y = np.zeros(size_of(g))
    stages, trial = np.zeros((_STAGES, y.size)), np.zeros(y.size)
    h = sample_s / steps
    for n in range(v.shape[0]):
        _impulse(v, n, g, y)
        for i in range(steps):
            m = n * steps + i
            _filtered(y, g, out[m, 0])
            _step(m * h, h, y, v[n], g, stages, trial)
            _filtered(y, g, out[m, 1])
    return out


@njit(cache=True, fastmath={"contract", "reassoc", "nsz"})
def integrate(v: FloatArray, sample_s: float, steps: int, g: Physics) -> FloatArray:
    """The record (N, 2) [V] from rest for drive samples v (N, 2) [V], with ``steps`` steps per sample of ``sample_s`` [s].

    With a delay of d + f samples, the output is read d whole samples and the fraction f of a sample earlier.
    """
    count = v.shape[0]
    out = np.zeros((count, 2))
    y = np.zeros(size_of(g))
    stages, trial = np.zeros((_STAGES, y.size)), np.zeros(y.size)
    before, after = np.zeros((2, 3)), np.zeros((2, 3))
    slow = np.zeros(2)
    late = g.delay_s / sample_s
    whole = int(np.floor(late))
    piece = late - whole
    for n in range(count):
        _impulse(v, n, g, y)
        if piece == 0.0 and n + whole < count:
            for k in range(2):
                out[n + whole, k] = slow[k] if g.pickoff_time_s > 0.0 else y[_FILTER + 8 * k + 6]
        start = n * sample_s
        # The next sample is read (1 - f) of a sample after the start of this hold, so the hold has two parts.
        for part in range(2):
            length = (1.0 - piece) if part == 0 else piece
            if length == 0.0:
                continue
            m = max(1, int(np.ceil(steps * length - 1e-9)))
            h = length * sample_s / m
            for i in range(m):
                if g.pickoff_time_s > 0.0:
                    _filtered(y, g, before)
                _step(start + i * h, h, y, v[n], g, stages, trial)
                if g.pickoff_time_s > 0.0:
                    _filtered(y, g, after)
                    for k in range(2):
                        slow[k] = lagged(slow[k], before[k], after[k], h, g.pickoff_time_s)
            start += length * sample_s
            if part == 0 and piece > 0.0 and n + whole + 1 < count:
                for k in range(2):
                    out[n + whole + 1, k] = slow[k] if g.pickoff_time_s > 0.0 else y[_FILTER + 8 * k + 6]
    return out
