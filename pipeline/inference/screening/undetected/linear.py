"""The linear motion of an identified device in the band, and its response to forces in the band.

    q(w)  = sum_k U_k F Phi_k(w) / G(w) + conj,                U_k = residues of (K + s C + s^2)^-1
    y(w)  = G(w) V i w (K - w^2 + i w C)^-1 {f(w) - f_s [q'(T) + (i w + C) q(T)]}

Phi_k is the response of a pole to the drive behind the filter (``inband``), G the filter.  The braces contain the motion at the
end of the record, T, since the record ends while the device rings:

    q(T) = 2 Re sum_k U_k e_k,   q'(T) = 2 Re sum_k p_k U_k e_k,   e_k = sum_n e^{p_k (T - t_n)} f(t_n) dt

Shapes: 3 modes and coordinates, D = 2 drives, S = 2 senses, W bins, n points of the grid.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from ....arrays import ComplexArray, FloatArray
from ....device.effect import Context
from ....device.effects.electrode_mismatch import mechanics as mismatched
from ....device.gyro import PHYSICAL, cartesian_modes, gyro_mechanics, to_physical
from ....device.mechanics import Mechanics, Modes, modes_of
from ....experiment.antialias import filter_response
from ....experiment.instrument import Instrument
from ..fit import Fit
from ..inband import Band
from ..likelihood import ORDER
from .narrow_band import Grid, Signals, signals_of


def device_mechanics(x: FloatArray, bias_v: float) -> tuple[Mechanics, Context]:
    """Mechanics (a batch of one) of parameters x (12,) or (14,), and what the stages of effects may use."""
    physical = to_physical(x[None, :12])
    plant = dict(zip(PHYSICAL, physical[0].tolist()))
    context = Context(bias_v, bias_v, plant)
    mechanics = gyro_mechanics(physical)
    return (mechanics if x.size == 12 else mismatched(mechanics, x[12:], context)), context


def cartesian_poles(x: FloatArray) -> tuple[ComplexArray, ComplexArray]:
    """Poles (3,) and residues (3, 2, 2) [rad/s] of parameters x (12,) or (14,)."""
    poles, residues = np.empty(3, dtype=np.complex128), np.empty((3, 2, 2), dtype=np.complex128)
    cartesian_modes(x, poles, residues)
    return poles, residues


def in_order(modes: Modes, poles: ComplexArray, i: int = 0) -> tuple[ComplexArray, ComplexArray]:
    """Poles (3,) and residues (3, ..) of device ``i`` of ``modes`` in the order of ``poles`` (3,)."""
    ascending = np.argsort(np.argsort(poles.imag))
    return modes.poles[i][ascending], modes.residues[i][ascending]


@dataclass(frozen=True, eq=False)
class LinearDevice:
    """A device in the band of one record.

    Parameters
    ----------
    band, context, mechanics : of the record and the device.
    poles, parts : p_k (3,) [rad/s] and U_k (3, 3, 3).
    responses : Phi and dPhi/dp, at the poles and at their conjugates, (4 3 D, W).
    s, antialias, drive : i w (W,) [rad/s], G(w) (W,), and the transform of the drive (D, W) [V] behind its hold.
    """

    band: Band
    context: Context
    mechanics: Mechanics
    poles: ComplexArray
    parts: ComplexArray
    responses: ComplexArray
    s: ComplexArray
    antialias: ComplexArray
    drive: ComplexArray

    def read(self, residues: ComplexArray, slopes: ComplexArray) -> ComplexArray:
        """sum_k R_k Phi_k + T_k dPhi_k/dp_k + conj, (.., C, W), of R and T (.., 3, C, D)."""
        both = np.stack([residues, slopes, residues.conj(), slopes.conj()], axis=-4)
        left = np.moveaxis(both, -2, -4).reshape(*both.shape[:-4], both.shape[-2], -1)
        return np.asarray(left @ self.responses)

    def signals(self, grid: Grid) -> Signals:
        """Envelopes of the motion and of the drive on a grid."""
        q = self.parts @ self.mechanics.drive[0]
        both = np.concatenate([q, q * self.poles[:, None, None]], axis=1)
        motion = self.read(both, np.zeros_like(both)) / self.antialias
        found = grid.envelopes(np.concatenate([motion, self.drive]))
        return signals_of(grid, found[:3], found[3:6], found[6:])

    def sensed(self) -> ComplexArray:
        """Pick-off volts behind the filter (S, W)."""
        r = self.pickoff_residues()
        return self.read(r, np.zeros_like(r))

    def pickoff_residues(self) -> ComplexArray:
        """R_k (3, S, D) [rad/s]."""
        m = self.mechanics
        read = m.velocity_sense[0] * self.poles[:, None, None] + m.position_sense[0]
        return np.asarray(read @ self.parts @ m.drive[0])

    def forced(self, force: ComplexArray, grid: Grid) -> ComplexArray:
        """Volts behind the filter (K, S, W) in response to envelopes of K forces (K, 3, n) [V/s]."""
        span = self.band.samples / self.band.sample_rate_hz
        left = np.exp(self.poles[:, None] * (span - grid.time_s) + 1j * grid.omega * grid.time_s)
        ends = np.moveaxis(force @ left.T, 2, 0) * (0.5 * span / grid.points)
        modal = ends @ np.swapaxes(self.parts, 1, 2)
        q_end = 2.0 * modal.real.sum(axis=0)
        v_end = 2.0 * (modal * self.poles[:, None, None]).real.sum(axis=0)
        s, m = self.s, self.mechanics
        spectrum = grid.spectra(force)
        boundary = v_end + q_end @ (m.damping[0] + m.gyroscopic[0]).T
        spectrum -= self.band.sample_rate_hz * (boundary[:, :, None] + q_end[:, :, None] * s)
        volts = np.zeros((force.shape[0], 2, s.size), dtype=np.complex128)
        for a, row in enumerate(self._transfer()):
            for c, own in enumerate(row):
                volts[:, a] += own * spectrum[:, c]
        return volts

    def _transfer(self) -> ComplexArray:
        """G (V s + D)(K + s C + s^2)^-1 (S, 3, W) by partial fractions."""
        m, s = self.mechanics, self.s
        poles = np.concatenate([self.poles, self.poles.conj()])
        parts = np.concatenate([self.parts, self.parts.conj()])
        gain = (m.velocity_sense[0] * poles[:, None, None] + m.position_sense[0]) @ parts
        resonances = self.antialias / (s - poles[:, None])
        return np.asarray(np.moveaxis(gain, 0, 2) @ resonances)


def hold_response(band: Band) -> ComplexArray:
    """Held drive over its samples (W,): (1 - z^-1) / (s T), squared and advanced by a step for first-order hold."""
    step = 2j * np.pi * band.bins / band.samples
    held = -np.expm1(-step) / step
    return held**2 * np.exp(step) if band.first_order_hold else held


@lru_cache(maxsize=4)
def frequency_axis(band: Band) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """i w (W,), G(w) (W,) and the drive behind its hold (D, W) [V], which all devices of a band share."""
    s = np.asarray(2j * np.pi * band.frequency_hz, dtype=np.complex128)
    return s, filter_response(band.antialias, s), band.now * hold_response(band)


def _responses(columns: FloatArray, expansion: ComplexArray, poles: ComplexArray) -> ComplexArray:
    """Phi and dPhi/dp at the poles, then at their conjugates, by mode and drive, (4 3 D, W).

    ``columns`` (2 W, J) are the features of ``compressed`` around ``expansion`` (3,) [rad/s]: of the orders m of the series
    Phi(p0 + h) = sum_m Phi_m h^m the sums Phi_m + Phi~_m and i (Phi_m - Phi~_m).
    """
    width = columns.shape[0] // 2
    features = columns.T.reshape(3, 2, 2 * (ORDER + 1), 2, width)
    straight, crossed = (np.abs(poles[:2] - e).sum() for e in (expansion[:2], expansion[1::-1]))
    source = [1, 0, 2] if crossed < straight else [0, 1, 2]
    h = poles - expansion[source]
    orders = np.arange(ORDER + 1)
    out = np.empty((4, 3, 2, width), dtype=np.complex128)
    for k in range(3):
        weights = []
        for shift, sign in ((h[k], -0.5j), (np.conj(h[k]), 0.5j)):
            powers = shift**orders
            slopes = np.concatenate([[0.0], orders[1:] * powers[:-1]])
            weights += [np.stack([0.5 * each, sign * each], axis=1).ravel() for each in (powers, slopes)]
        own = features[source[k]]
        out[:, k] = np.swapaxes(np.array(weights) @ (own[:, :, 0] + 1j * own[:, :, 1]), 0, 1)
    return out.reshape(-1, width)


def linear_device(fit: Fit, record: int, band: Band, instrument: Instrument) -> LinearDevice:
    """The linear device of a fit in the band of its ``record``; raises as ``modes_of``."""
    x = fit.x
    mechanics, context = device_mechanics(x, instrument.bias_v)
    unit = np.eye(3)[None]
    modes = modes_of(replace(mechanics, drive=unit, velocity_sense=np.zeros((1, 3, 3)), position_sense=unit))
    poles, parts = in_order(modes, cartesian_poles(x)[0])
    features = fit.likelihood.columns[record]
    responses = _responses(features, fit.likelihood.expansion, poles)
    return LinearDevice(band, context, mechanics, poles, parts, responses, *frequency_axis(band))
