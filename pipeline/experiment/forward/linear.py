"""Linear part of a record: mechanics and read-out as one bank of poles, exact at the sample times.

    y = G(s) exp(-s tau) [(H(s) + E) u + (R + s C) v]

- G H in partial fractions has the residues G(p_k) R_k at the poles p_k of the mechanics and Q_j H(q_j) at the poles q_j of
  the read-out.
- Feedthrough followed by a filter has the residues Q_j (R + q_j C) at q_j, plus the direct part (sum_j Q_j) C.  Without a filter
  it is R v plus C times the slope of v just before the sample.
- E u, the part of a pick-off of acceleration that follows the drive at once (``Mechanics.direct``), acts like R v.
- A delay tau reads each state before its sample: with m + 1 = ceil(tau f_s) and t = (m + 1)/f_s - tau,

      x(n/f_s - tau) = e^{p t} x[n - m - 1] + (response to the held drive over t)

- The records of a drive group are scaled copies of few waveforms, and the state of a pole is computed once per waveform:

      y_r = sum_w sum_d gain[r, d, w] (response of drive d to waveform w)

Shapes: N samples (at the steps of the clock), D drives, S senses, P poles, J read-out poles, W waveforms, R records.
Units: poles in rad/s, time in seconds, drives and responses in volts.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import floor

import numpy as np
from numba import njit

from ...arrays import ComplexArray, FloatArray
from ...device.mechanics import Mechanics, modes_of, state_matrix
from ...device.readout import Readout
from ..instrument import Hold
from .modal_bank import hold_gains

_OVERSAMPLING = 8


@dataclass(frozen=True, eq=False)
class SampleClock:
    """Steps at which a held drive is computed; "bandlimited" is first-order hold on a drive interpolated eightfold.

    step_s : time between steps [s]; hold : "zoh" or "foh"; stride : steps per sample.
    """

    step_s: float
    hold: Hold
    stride: int


def clock_of(sample_rate_hz: float, hold: Hold) -> SampleClock:
    """The clock of records with this sample rate [Hz] and hold."""
    if hold == "bandlimited":
        return SampleClock(1.0 / (sample_rate_hz * _OVERSAMPLING), "foh", _OVERSAMPLING)
    return SampleClock(1.0 / sample_rate_hz, hold, 1)


def interpolated(drive_v: FloatArray, clock: SampleClock) -> FloatArray:
    """Drive samples (N, D) [V] at the steps of the clock, (N stride, D)."""
    if clock.stride == 1:
        return np.ascontiguousarray(drive_v)
    # Importing scipy.signal takes a third of a second.
    from scipy.signal import resample_poly

    return np.ascontiguousarray(resample_poly(drive_v, clock.stride, 1, axis=0))


def upper_poles(readout: Readout) -> tuple[ComplexArray, ComplexArray]:
    """Poles (J,) with Im >= 0 and residues (J, S, S) [rad/s]; a real pole has half its residue, because conj is added."""
    real = np.abs(readout.poles.imag) <= 1e-9 * np.abs(readout.poles)
    keep = (readout.poles.imag > 0.0) | real
    weight = np.where(real, 0.5, 1.0)[keep]
    return readout.poles[keep], readout.residues[keep] * weight[:, None, None]


def delay_steps(delay_s: float, step_s: float) -> tuple[int, float]:
    """A delay as whole steps to shift by, and the time after each step [s] at which to read."""
    whole = floor(delay_s / step_s + 1e-12)
    rest = max(delay_s - whole * step_s, 0.0)
    return (whole, 0.0) if rest < 1e-12 * step_s else (whole + 1, step_s - rest)


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc", "nsz"})
def _states(
    z_re: FloatArray,
    z_im: FloatArray,
    a_re: FloatArray,
    a_im: FloatArray,
    b_re: FloatArray,
    b_im: FloatArray,
    drive: FloatArray,
    out: FloatArray,
) -> None:
    """Fill ``out`` (N, 2P) with x[n+1] = z x[n] + a v[n] + b v[n+1] from rest: real parts, then imaginary parts."""
    poles = z_re.size
    for j in range(2 * poles):
        out[0, j] = 0.0
    for n in range(drive.size - 1):
        now, following = drive[n], drive[n + 1]
        for j in range(poles):
            re, im = out[n, j], out[n, poles + j]
            out[n + 1, j] = z_re[j] * re - z_im[j] * im + a_re[j] * now + b_re[j] * following
            out[n + 1, poles + j] = z_re[j] * im + z_im[j] * re + a_im[j] * now + b_im[j] * following


def _bank_response(
    poles: ComplexArray,
    residues: ComplexArray,
    waveforms: FloatArray,
    gains: FloatArray,
    clock: SampleClock,
    late_s: float,
) -> FloatArray:
    """Response (N, R, S) [V] of a bank of poles to all records, read ``late_s`` after each step."""
    advanced = residues if late_s == 0.0 else residues * np.exp(poles * late_s)[:, None, None]
    z, g0, g1 = hold_gains(poles, clock.step_s, clock.hold)
    parts = [np.ascontiguousarray(part) for g in (z, g0, g1) for part in (g.real, g.imag)]
    samples = waveforms.shape[1]
    y = np.zeros((samples, gains.shape[0] * residues.shape[1]))
    states, own = np.empty((samples, 2 * poles.size)), np.empty_like(y)
    for w, waveform in enumerate(waveforms):
        mixed = np.einsum("psd,rd->prs", advanced, gains[:, :, w]).reshape(poles.size, -1)
        _states(parts[0], parts[1], parts[2], parts[3], parts[4], parts[5], waveform, states)
        # 2 Re R x = 2 Re R Re x - 2 Im R Im x
        y += np.matmul(states, np.concatenate([2.0 * mixed.real, -2.0 * mixed.imag]), out=own)
    if late_s > 0.0:
        whole = np.expm1(poles * late_s) / poles
        y += waveforms.T @ _spread(2.0 * np.sum(residues * whole[:, None, None], axis=0).real, gains)
        if clock.hold != "zoh":
            rise = (np.expm1(poles * late_s) - poles * late_s) / (poles**2 * clock.step_s)
            ramp = 2.0 * np.sum(residues * rise[:, None, None], axis=0).real
            y[:-1] += np.diff(waveforms, axis=1).T @ _spread(ramp, gains)
    return y.reshape(samples, gains.shape[0], residues.shape[1])


def _spread(matrix: FloatArray, gains: FloatArray) -> FloatArray:
    """Response (W, R S) of a static matrix (S, D) to each waveform in each record."""
    return np.asarray(np.einsum("sd,rdw->wrs", matrix, gains).reshape(gains.shape[2], gains.shape[0] * matrix.shape[0]))


def linear_response(
    mechanics: Mechanics,
    readout: Readout,
    waveforms: FloatArray,
    gains: FloatArray,
    clock: SampleClock,
    feeds: bool = True,
) -> FloatArray:
    """Linear response y (R, N, S) [V] at the steps of the clock, from rest.

    Parameters
    ----------
    mechanics : a batch of one.
    readout : filter, feedthrough and delay.
    waveforms : (W, N) [V].
    gains : (R, D, W), the share of each waveform in each drive of each record.
    clock : step and hold.
    feeds : whether the feedthrough is included.
    """
    modes = modes_of(mechanics)
    p, r = modes.poles[0], modes.residues[0]
    q, g = upper_poles(readout)
    shift, late_s = delay_steps(readout.delay_s, clock.step_s)
    poles, residues = p, readout.response(p) @ r
    fed = feeds and bool(np.any(readout.resistive) or np.any(readout.capacitive))
    if q.size:
        filter_residues = g @ np.moveaxis(modes.response(q)[0], -1, 0)
        if fed:
            # Feedthrough and filter: sum_j Q_j (R + s C)/(s - q_j).
            filter_residues = filter_residues + g @ (readout.resistive + q[:, None, None] * readout.capacitive)
        poles, residues = np.concatenate([p, q]), np.concatenate([residues, filter_residues])
    y = _bank_response(poles, residues, waveforms, gains, clock, late_s)
    if fed or mechanics.senses_acceleration:
        none = np.zeros_like(readout.resistive)
        fed_now = readout if fed else replace(readout, resistive=none, capacitive=none)
        fed_now = replace(fed_now, resistive=fed_now.resistive + modes.direct[0])
        y += _direct_feedthrough(fed_now, g, waveforms, gains, clock, late_s)
    return np.moveaxis(shifted(y, shift), 1, 0)


def fed_through(readout: Readout, waveforms: FloatArray, gains: FloatArray, clock: SampleClock) -> FloatArray:
    """The feedthrough without the mechanics, (R, N, S) [V]; arguments as in ``linear_response``."""
    q, g = upper_poles(readout)
    shift, late_s = delay_steps(readout.delay_s, clock.step_s)
    y = _direct_feedthrough(readout, g, waveforms, gains, clock, late_s)
    if q.size:
        residues = g @ (readout.resistive + q[:, None, None] * readout.capacitive)
        y += _bank_response(q, residues, waveforms, gains, clock, late_s)
    return np.moveaxis(shifted(y, shift), 1, 0)


def _direct_feedthrough(
    readout: Readout, g: ComplexArray, waveforms: FloatArray, gains: FloatArray, clock: SampleClock, late_s: float
) -> FloatArray:
    """The direct part of the feedthrough, (N, R, S) [V]: the held drive and its slope."""
    direct = readout.static @ readout.resistive
    slope = readout.static @ readout.capacitive
    if g.size:
        direct = direct + 2.0 * g.sum(axis=0).real @ readout.capacitive
    now = waveforms
    if late_s > 0.0 and clock.hold != "zoh":
        now = waveforms.copy()
        now[:, :-1] += np.diff(waveforms, axis=1) * (late_s / clock.step_s)
    y = now.T @ _spread(direct, gains)
    if np.any(slope):
        arriving = np.diff(waveforms, axis=1, prepend=waveforms[:, :1]) / clock.step_s
        y += arriving.T @ _spread(slope, gains)
    return np.asarray(y.reshape(waveforms.shape[1], gains.shape[0], -1))


def direct_gain(mechanics: Mechanics, readout: Readout) -> FloatArray:
    """(S, D) [1]: what of the response follows the drive at once."""
    g = upper_poles(readout)[1]
    gain = readout.static @ (readout.resistive + mechanics.direct[0])
    return np.asarray(gain + 2.0 * g.sum(axis=0).real @ readout.capacitive if g.size else gain)


def shifted(y: FloatArray, steps: int) -> FloatArray:
    """y (N, ...) delayed by whole samples, zero before; advanced by them, it keeps its last value; unit unchanged."""
    if steps == 0:
        return y
    out = np.zeros_like(y)
    if steps < 0:
        out[:steps], out[steps:] = y[-steps:], y[-1]
        return out
    out[steps:] = y[: max(y.shape[0] - steps, 0)]
    return out


def free_response(mechanics: Mechanics, readout: Readout, samples: int, clock: SampleClock) -> FloatArray:
    """Free response (N, S, 2n) to a unit of each initial position [V s] and velocity [V], with the filter settled."""
    n = mechanics.stiffness.shape[-1]
    poles, right = np.linalg.eig(state_matrix(mechanics)[0])
    left = np.linalg.inv(right)
    sensed = mechanics.reads[0] @ right
    gain = np.einsum("ksj,jk->ks", readout.response(poles), sensed) * readout.lag(poles)
    decay = np.exp(np.arange(samples)[:, None] * (poles * clock.step_s))
    parts = (gain[:, :, None] * left[:, None, :]).reshape(2 * n, -1)
    return np.asarray((decay @ parts).real.reshape(samples, -1, 2 * n))
