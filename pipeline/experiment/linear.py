"""Linear part of a record: mechanics and read-out as one bank of poles, exact at the sample times.

    y = G(s) exp(-s tau) [H(s) u + (R + s C) v]

G H in partial fractions: G(p_k) R_k at the mechanics' poles p_k, Q_j H(q_j) at the read-out's q_j.  The feedthrough
behind a filter is Q_j (R + q_j C) at q_j and (sum_j Q_j) C at once; without a filter R v and C times the slope of v
that arrives at the sample.  A delay reads each state before its sample: with m + 1 = ceil(tau f_s) and t = (m +
1)/f_s - tau,

    x((n f_s) - tau) = e^{p t} x[n - m - 1] + (response to the held drive over t)

Shapes: N samples, D drives, S senses, P poles, J read-out poles.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import floor

import numpy as np
from scipy.signal import resample_poly

from ..arrays import ComplexArray, FloatArray
from ..device.mechanics import Mechanics, modes_of, state_matrix
from ..device.readout import Readout
from .antialias import Bank
from .instrument import Hold
from .simulate import respond

_OVERSAMPLING = 8


@dataclass(frozen=True, eq=False)
class Clock:
    """Held samples as the engine steps them: "bandlimited" is first-order hold on drives interpolated eightfold."""

    step_s: float
    hold: Hold
    stride: int


def clock_of(sample_rate_hz: float, hold: Hold) -> Clock:
    """The clock of a record."""
    if hold == "bandlimited":
        return Clock(1.0 / (sample_rate_hz * _OVERSAMPLING), "foh", _OVERSAMPLING)
    return Clock(1.0 / sample_rate_hz, hold, 1)


def interpolated(drive_v: FloatArray, clock: Clock) -> FloatArray:
    """Drive samples (N, D) at the clock's steps."""
    if clock.stride == 1:
        return np.ascontiguousarray(drive_v)
    return np.ascontiguousarray(resample_poly(drive_v, clock.stride, 1, axis=0))


def upper_poles(readout: Readout) -> tuple[ComplexArray, ComplexArray]:
    """Poles with Im >= 0 and their residues; a real pole with half its residue, since its conjugate is added."""
    real = np.abs(readout.poles.imag) < 1e-9 * np.abs(readout.poles)
    keep = (readout.poles.imag > 0.0) | real
    weight = np.where(real, 0.5, 1.0)[keep]
    return readout.poles[keep], readout.residues[keep] * weight[:, None, None]


def delay_steps(delay_s: float, step_s: float) -> tuple[int, float]:
    """Whole steps to shift by, and the time after each step [s] at which to read."""
    whole = floor(delay_s / step_s + 1e-12)
    rest = max(delay_s - whole * step_s, 0.0)
    return (whole, 0.0) if rest < 1e-12 * step_s else (whole + 1, step_s - rest)


def shifted(y: FloatArray, steps: int) -> FloatArray:
    """y (N, S) that many samples later, zero before."""
    if steps == 0:
        return y
    out = np.zeros_like(y)
    out[steps:] = y[: max(y.shape[0] - steps, 0)]
    return out


def _read(poles: ComplexArray, residues: ComplexArray, drive: FloatArray, clock: Clock, late_s: float) -> FloatArray:
    """Bank response (N, S) read ``late_s`` after each step."""
    turned = residues if late_s == 0.0 else residues * np.exp(poles * late_s)[:, None, None]
    y = respond(Bank(poles[None], turned[None]), drive, 1.0 / clock.step_s, clock.hold)[0]
    if late_s == 0.0:
        return y
    whole = np.expm1(poles * late_s) / poles
    y += drive @ (2.0 * np.sum(residues * whole[:, None, None], axis=0).real).T
    if clock.hold != "zoh":
        rise = (np.expm1(poles * late_s) - poles * late_s) / (poles**2 * clock.step_s)
        y[:-1] += np.diff(drive, axis=0) @ (2.0 * np.sum(residues * rise[:, None, None], axis=0).real).T
    return y


def linear_response(mechanics: Mechanics, readout: Readout, u: FloatArray, v: FloatArray, clock: Clock) -> FloatArray:
    """y (N, S) at the clock's steps, from rest.

    Parameters
    ----------
    mechanics : a batch of one.
    readout : read-out with feedthrough and delay.
    u : (N, D) volts that make force.
    v : (N, D) drive samples, which feed through.
    clock : step and hold.
    """
    modes = modes_of(mechanics)
    p, r = modes.poles[0], modes.residues[0]
    q, g = upper_poles(readout)
    shift, late_s = delay_steps(readout.delay_s, clock.step_s)
    own = readout.response(p) @ r
    if q.size:
        poles, residues = np.concatenate([p, q]), np.concatenate([own, g @ np.moveaxis(modes.response(q)[0], -1, 0)])
    else:
        poles, residues = p, own
    y = _read(poles, residues, u, clock, late_s)
    if np.any(readout.resistive) or np.any(readout.capacitive):
        y += _feedthrough(readout, q, g, v, clock, late_s)
    return shifted(y, shift)


def _feedthrough(
    readout: Readout, q: ComplexArray, g: ComplexArray, v: FloatArray, clock: Clock, late_s: float
) -> FloatArray:
    at_once = readout.static @ readout.resistive
    slope = readout.static @ readout.capacitive
    if q.size:
        # Feedthrough and filter: sum_j Q_j (R + s C)/(s - q_j).
        at_once = at_once + 2.0 * g.sum(axis=0).real @ readout.capacitive
        y = _read(q, g @ (readout.resistive + q[:, None, None] * readout.capacitive), v, clock, late_s)
    else:
        y = np.zeros((v.shape[0], at_once.shape[0]))
    now = v
    if late_s > 0.0 and clock.hold != "zoh":
        now = v.copy()
        now[:-1] += np.diff(v, axis=0) * (late_s / clock.step_s)
    y += now @ at_once.T
    if np.any(slope):
        arriving = np.diff(v, axis=0, prepend=v[:1]) / clock.step_s
        y += arriving @ slope.T
    return y


def free_response(mechanics: Mechanics, readout: Readout, samples: int, clock: Clock) -> FloatArray:
    """(N, S, 2n): what a unit of each initial position and velocity leaves in the record, filter settled."""
    n = mechanics.stiffness.shape[-1]
    poles, right = np.linalg.eig(state_matrix(mechanics)[0])
    left = np.linalg.inv(right)
    seen = np.concatenate([mechanics.position_sense[0], mechanics.velocity_sense[0]], axis=1) @ right
    gain = np.einsum("ksj,jk->ks", readout.response(poles), seen) * np.exp(-poles * readout.delay_s)[:, None]
    decay = np.exp(np.arange(samples)[:, None] * (poles * clock.step_s))
    parts = (gain[:, :, None] * left[:, None, :]).reshape(2 * n, -1)
    return np.asarray((decay @ parts).real.reshape(samples, -1, 2 * n))
