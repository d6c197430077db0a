"""The linear motion of an identified device in the band, and its response to forces in the band.

    q(w)  = sum_k U_k F Phi_k(w) / G(w) + conj,                U_k = residues of (K + s C + s^2)^-1
    y(w)  = G(w) V i w (K - w^2 + i w C)^-1 {f(w) - f_s [q'(T) + (i w + C) q(T)]}

Phi_k is the response of a pole to the drive behind the filter (``inband``), G the filter.  The braces contain the motion at the
end of the record, T, since the record ends while the device rings:

    q(T) = 2 Re sum_k U_k e_k,   q'(T) = 2 Re sum_k p_k U_k e_k,   e_k = sum_n e^{p_k (T - t_n)} f(t_n) dt

Shapes: 3 modes and coordinates, D = 2 drives, S = 2 senses, W bins, n points of the grid.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ....arrays import AnyComplexArray, ComplexArray, FloatArray, RealArray, real_parts
from ....device.effect import Context
from ....device.effects.electrode_mismatch import mechanics as mismatched
from ....device.gyro import PHYSICAL, cartesian_mechanics, to_physical
from ....device.mechanics import Mechanics, modes_of, state_matrix
from ....experiment.antialias import filter_response
from ....experiment.instrument import Instrument
from ..fit import Fit, modes_at
from ..inband import Band
from ..kept import kept_if_short
from ..likelihood import ORDER
from .narrow_band import Grid, Signals
from .respond import respond


@dataclass(frozen=True, eq=False)
class _Plant(Mapping[str, float]):
    """Physical parameters of x (P,) by name, which few effects use."""

    x: FloatArray

    @cached_property
    def _values(self) -> dict[str, float]:
        return dict(zip(PHYSICAL, to_physical(self.x[None, :12])[0].tolist()))

    def __getitem__(self, name: str) -> float:
        return self._values[name]

    def __iter__(self) -> Iterator[str]:
        return iter(PHYSICAL)

    def __len__(self) -> int:
        return len(PHYSICAL)


def device_mechanics(x: FloatArray, bias_v: float) -> tuple[Mechanics, Context]:
    """Mechanics (a batch of one) of parameters x (12,) or (14,), and what the stages of effects may use."""
    context = Context(bias_v, bias_v, _Plant(x))
    mechanics = cartesian_mechanics(x[None, :12])
    return (mechanics if x.size == 12 else mismatched(mechanics, x[12:], context)), context


@dataclass(frozen=True, eq=False)
class BandMotion:
    """Spectra behind the filter.

    Parameters
    ----------
    of_drives : the part of each drive (D, S, W) [V] of the pick-off volts.
    spectra : coordinates and velocities (3 + 3, W) [V s, V].
    """

    of_drives: ComplexArray
    spectra: ComplexArray

    @cached_property
    def sensed(self) -> ComplexArray:
        """Pick-off volts (S, W) [V]."""
        return np.asarray(self.of_drives.sum(axis=0))


@dataclass(frozen=True, eq=False)
class LinearDevice:
    """A device in the band of one record.

    Parameters
    ----------
    band, context, mechanics : of the record and the device.
    poles, parts : p_k (3,) [rad/s] and U_k (3, 3, 3).
    columns, shifts, source : features of ``compressed`` (2 W, J), and of each mode the shift h (3,) [rad/s] from the pole of
        the expansion that has the index ``source`` (3,).
    s, antialias, drive : i w (W,) [rad/s], G(w) (W,), and the transform of the drive (D, W) [V] behind its hold.
    """

    band: Band
    context: Context
    mechanics: Mechanics
    poles: ComplexArray
    parts: ComplexArray
    columns: FloatArray
    shifts: ComplexArray
    source: tuple[int, ...]
    s: ComplexArray
    antialias: ComplexArray
    drive: ComplexArray

    def coefficients(self, residues: ComplexArray, slopes: ComplexArray | None = None) -> FloatArray:
        """Those (.., C, J) of sum_k R_k Phi_k + T_k dPhi_k/dp_k + conj in the features, of R and T (.., 3, C, D)."""
        orders = np.arange(ORDER + 1)
        powers = self.shifts[:, None] ** orders
        series = residues[..., None] * powers[:, None, None]
        if slopes is not None:
            series[..., 1:] += slopes[..., None] * (orders[1:] * powers[:, :-1])[:, None, None]
        by_channel = np.ascontiguousarray(np.moveaxis(series[..., self.source, :, :, :], -3, -4))
        return by_channel.view(np.float64).reshape(*by_channel.shape[:-3], -1)

    def rows(self, coefficients: FloatArray, out: FloatArray | None = None) -> FloatArray:
        """Spectra (.., 2 W), real parts before imaginary ones, of coefficients (.., J) of the features."""
        whole = np.empty((*coefficients.shape[:-1], self.columns.shape[0])) if out is None else out
        flat = coefficients.reshape(-1, coefficients.shape[-1])
        np.matmul(flat, self.columns.T, out=whole.reshape(flat.shape[0], -1))
        return whole

    @property
    def motion_coefficients(self) -> FloatArray:
        """Coefficients (D S + 3 + 3, J) of the pick-off volts of each drive, the coordinates and the velocities."""
        q = self.parts @ self.mechanics.drive[0]
        drives = q.shape[2]
        alone = (np.eye(drives)[:, None, None] * self.pickoff_residues).swapaxes(0, 1).reshape(3, -1, drives)
        return self.coefficients(np.concatenate([alone, q, q * self.poles[:, None, None]], axis=1))

    def motion(self, rows: FloatArray) -> BandMotion:
        """The motion from the rows (D S + 3 + 3, 2 W) of its coefficients."""
        out = np.empty((rows.shape[0], self.s.size), dtype=np.complex128)
        out.real, out.imag = rows[:, : self.s.size], rows[:, self.s.size :]
        return BandMotion(out[:-6].reshape(self.drive.shape[0], -1, self.s.size), out[-6:])

    def signals(self, motion: BandMotion, grid: Grid) -> Signals:
        """Envelopes of the motion and of the drive on a grid."""
        inverse, drive = shared_signals(self.band, grid)
        whole = np.empty((6 + drive.shape[0], grid.points), dtype=np.complex64)
        whole[:6], whole[6:] = grid.envelopes((motion.spectra * inverse).astype(np.complex64)), drive
        return Signals(grid, np.arange(grid.points), whole)

    @cached_property
    def pickoff_residues(self) -> ComplexArray:
        """R_k (3, S, D) [rad/s]."""
        m = self.mechanics
        read = m.velocity_sense[0] * self.poles[:, None, None] + m.position_sense[0]
        return np.asarray(read @ self.parts @ m.drive[0])

    def forced(self, force: AnyComplexArray, grid: Grid, out: FloatArray) -> FloatArray:
        """Volts behind the filter in response to envelopes of K forces (K, 3, n) [V/s], as the first rows of ``out`` (.., S, 2 W)."""
        span = self.band.samples / self.band.sample_rate_hz
        # exp(i w0 t + p (T - t)), counted back from the end T: a strongly damped mode would overflow from the start.
        decay, turn = self.poles - 1j * grid.omega, 1j * grid.omega * span
        left = grid.powers(decay)[:, ::-1] * np.exp(decay * span / grid.points + turn)[:, None]
        count = force.shape[0]
        ends = (force.reshape(-1, grid.points) @ left.T.astype(force.dtype)).reshape(count, 3, 3) * (0.5 * span / grid.points)
        modal = np.einsum("kij,bjk->kbi", self.parts, ends)
        q_end = 2.0 * modal.real.sum(axis=0)
        v_end = 2.0 * (modal * self.poles[:, None, None]).real.sum(axis=0)
        m = self.mechanics
        ringing = np.stack([v_end + q_end @ (m.damping[0] + m.gyroscopic[0]).T, q_end], axis=2)
        ringing *= self.band.sample_rate_hz / grid.bin_scale
        transfer = real_parts(self._transfer() * grid.bin_scale).astype(np.float32)
        respond(
            grid.transforms(force), grid.below, ringing.astype(np.float32), self._omega, transfer, out[:count]
        )
        return out[:count]

    @property
    def _omega(self) -> RealArray:
        return self.s.imag.astype(np.float32)

    def _transfer(self) -> ComplexArray:
        """G (V s + D)(K + s C + s^2)^-1 (3, S, W) by partial fractions."""
        m, s = self.mechanics, self.s
        poles = np.concatenate([self.poles, self.poles.conj()])
        parts = np.concatenate([self.parts, self.parts.conj()])
        gain = (m.velocity_sense[0] * poles[:, None, None] + m.position_sense[0]) @ parts
        resonances = self.antialias / (s - poles[:, None])
        return np.asarray((gain.T.reshape(-1, poles.size) @ resonances).reshape(3, 2, -1))


def hold_response(band: Band) -> ComplexArray:
    """Held drive over its samples (W,): (1 - z^-1) / (s T), squared and advanced by a step for first-order hold."""
    step = 2j * np.pi * band.bins / band.samples
    held = -np.expm1(-step) / step
    return held**2 * np.exp(step) if band.first_order_hold else held


@kept_if_short(4)
def frequency_axis(band: Band) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """i w (W,), G(w) (W,) and the drive behind its hold (D, W) [V], which all devices of a band share."""
    s = np.asarray(2j * np.pi * band.frequency_hz, dtype=np.complex128)
    return s, filter_response(band.antialias, s), band.now * hold_response(band)


@kept_if_short(4)
def shared_signals(band: Band, grid: Grid) -> tuple[ComplexArray, ComplexArray]:
    """1 / G (W,), in units of the grid, and the envelopes of the drive (D, n) [V], which all devices of a band share."""
    _, antialias, drive = frequency_axis(band)
    return 1.0 / (grid.bin_scale * antialias), grid.envelopes(drive / grid.bin_scale)


def _position_modes(every: Sequence[Mechanics], own: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
    """Poles (B, 3) [rad/s] and residues (B, 3, 3, 3) of (K + s C + s^2)^-1, in the order of the poles ``own`` (3,).

    They are those of ``modes_of`` with unit drive and sense.

    Raises
    ------
    ConfigError : as in ``modes_of``.
    """
    state = np.concatenate([state_matrix(one) for one in every])
    roots, right = np.linalg.eig(state)
    modes = np.argsort(np.where(roots.imag > 0.0, roots.imag, np.inf), axis=1)[:, :3][
        :, np.argsort(np.argsort(own.imag))
    ]
    batch = np.arange(len(every))[:, None]
    poles = roots[batch, modes]
    if not np.all(poles.imag > 0.0):
        # It states which mode does not oscillate.
        modes_of(every[int(np.argmin(poles.imag.min(axis=1)))])
    left = np.linalg.inv(right)[batch, modes, 3:]
    return poles, right[batch, :3, modes][:, :, :, None] * left[:, :, None]


@dataclass(frozen=True, eq=False)
class Moved:
    """Poles (B, 3) and residues (B, 3, S, D) [rad/s] of B other mechanics, in the order of those of the device."""

    poles: ComplexArray
    residues: ComplexArray


def linear_devices(
    fit: Fit,
    bands: Sequence[Band],
    instrument: Instrument,
    others: Callable[[Mechanics, Context], Sequence[Mechanics]],
) -> tuple[tuple[LinearDevice, ...], Moved]:
    """The linear device of a fit in the band of each record, and the modes of ``others``, functions of its mechanics.

    Raises
    ------
    ConfigError : a mode does not oscillate, as in ``modes_of``.
    """
    x, expansion = fit.x, fit.likelihood.expansion
    mechanics, context = device_mechanics(x, instrument.bias_v)
    every = [mechanics, *others(mechanics, context)]
    poles, parts = _position_modes(every, modes_at(x)[0])
    read, position = (
        np.concatenate([getattr(one, name) for one in every]) for name in ("velocity_sense", "position_sense")
    )
    drive = np.concatenate([one.drive for one in every])
    residues = (read[:, None] * poles[:, :, None, None] + position[:, None]) @ parts @ drive[:, None]
    first, second = poles[0, :2]
    straight = abs(first - expansion[0]) + abs(second - expansion[1])
    crossed = abs(first - expansion[1]) + abs(second - expansion[0])
    source = (1, 0, 2) if crossed < straight else (0, 1, 2)
    shifts = poles[0] - expansion[list(source)]
    devices = tuple(
        LinearDevice(band, context, mechanics, poles[0], parts[0], columns, shifts, source, *frequency_axis(band))
        for band, columns in zip(bands, fit.likelihood.columns)
    )
    return devices, Moved(poles[1:], residues[1:])
