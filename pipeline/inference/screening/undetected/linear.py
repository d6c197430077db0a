"""The linear motion of an identified device in the band, and its response to forces in the band.

    q(w)  = sum_k U_k F Phi_k(w) / G(w) + conj,                U_k = residues of (K + s C + s^2)^-1
    y(w)  = G(w) V i w (K - w^2 + i w C)^-1 {f(w) - f_s [q'(T) + (i w + C) q(T)]}

Phi_k is the response of a pole to the drive behind the filter (``inband``), G the filter.  The braces contain the motion at the
end of the record, T, since the record ends while the device rings:

    q(T) = 2 Re sum_k U_k e_k,   q'(T) = 2 Re sum_k p_k U_k e_k,   e_k = sum_n e^{p_k (T - t_n)} f(t_n) dt

Shapes: 3 modes and coordinates, D = 2 drives, S = 2 senses, W bins, n points of the grid.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ....arrays import AnyComplexArray, ComplexArray, FloatArray, IntArray, RealArray, real_parts
from ....device.effect import Context
from ....device.effects.electrode_mismatch import mechanics as mismatched
from ....device.gyro import PHYSICAL, cartesian_mechanics, to_physical
from ....device.mechanics import Mechanics
from ....experiment.antialias import filter_response
from ....experiment.instrument import Instrument
from ..fit import Fit, modes_at
from ..inband import Band
from ..kept import kept_if_short
from ..likelihood import ORDER
from .library import Probe
from .loops import in_features, respond
from .narrow_band import Grid, Signals
from .position_modes import PositionModes


def device_mechanics(x: FloatArray, bias_v: float) -> tuple[Mechanics, list[Context]]:
    """Mechanics of the parameters x (B, 12) or (B, 14) of B devices, and what the stages of effects may use of each."""
    plants = to_physical(x[:, :12])
    contexts = [Context(bias_v, bias_v, dict(zip(PHYSICAL, plant))) for plant in plants.tolist()]
    mechanics = cartesian_mechanics(x[:, :12])
    if x.shape[1] == 12:
        return mechanics, contexts
    return mismatched(
        mechanics, x[:, 12:].T[..., None], Context(bias_v, bias_v, dict(zip(PHYSICAL, plants.T)))
    ), contexts


@dataclass(frozen=True, eq=False)
class BandMotion:
    """Spectra behind the filter, real parts before imaginary ones.

    Parameters
    ----------
    of_drives : the part of each drive (D, S, 2 W) [V] of the pick-off volts.
    moving : coordinates and velocities (3 + 3, 2 W) [V s, V].
    """

    of_drives: FloatArray
    moving: FloatArray

    @cached_property
    def sensed(self) -> FloatArray:
        """Pick-off volts (S, 2 W) [V]."""
        return np.asarray(self.of_drives.sum(axis=0))


@dataclass(frozen=True, eq=False)
class DeviceForces:
    """Parameters whose forces in the band are known, each at its value; ``orders`` are those of the forces in the parameters.

    rows (K, 3): which of the ``transforms`` a force has on each coordinate; -1 where it has none.
    transforms (R, n) of the envelopes of forces (``Grid.transforms``), and ``ringing`` (K, 3, 2): f_s [q'(T) + C q(T)] and
    f_s q(T) [V/s], both in units of the grid and in single precision.
    """

    probes: Sequence[Probe]
    values: Sequence[float]
    orders: Sequence[int]
    rows: IntArray
    transforms: AnyComplexArray
    ringing: RealArray


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
        *several, modes, channels, drives = residues.shape
        flat = (-1, modes, channels, drives)
        out = np.empty((residues.size // (modes * channels * drives), channels, modes, drives, ORDER + 1, 2))
        # Without T its part is that of R with no weight.
        moving = residues if slopes is None else slopes
        weight = 0.0 if slopes is None else 1.0
        # A second layout in memory would be compiled a second time, which takes 1 MB of each worker.
        residues, moving = np.ascontiguousarray(residues), np.ascontiguousarray(moving)
        in_features(residues.reshape(flat), moving.reshape(flat), weight, self.shifts, self.source, out)
        return out.reshape(*several, channels, -1)

    def rows(self, coefficients: FloatArray, out: FloatArray | None = None) -> FloatArray:
        """Spectra (.., 2 W), real parts before imaginary ones, of coefficients (.., J) of the features."""
        whole = np.empty((*coefficients.shape[:-1], self.columns.shape[0])) if out is None else out
        flat = coefficients.reshape(-1, coefficients.shape[-1])
        np.matmul(flat, self.columns.T, out=whole.reshape(flat.shape[0], -1))
        return whole

    @property
    def motion_coefficients(self) -> FloatArray:
        """Coefficients (D S + 3 + 3, J) of the pick-off volts of each drive, the coordinates and the velocities."""
        q, read = self.parts @ self.mechanics.drive[0], self.pickoff_residues
        senses, drives = read.shape[1:]
        residues = np.zeros((3, drives * senses + 6, drives), dtype=np.complex128)
        for d in range(drives):
            residues[:, d * senses : (d + 1) * senses, d] = read[:, :, d]
        residues[:, -6:-3], residues[:, -3:] = q, q * self.poles[:, None, None]
        return self.coefficients(residues)

    def motion(self, rows: FloatArray) -> BandMotion:
        """The motion from the rows (D S + 3 + 3, 2 W) of its coefficients."""
        return BandMotion(rows[:-6].reshape(self.drive.shape[0], -1, rows.shape[1]), rows[-6:])

    def signals(self, motion: BandMotion, grid: Grid) -> Signals:
        """Envelopes of the motion and of the drive on a grid."""
        inverse, drive = shared_signals(self.band, grid)
        whole = np.empty((6 + drive.shape[0], grid.points), dtype=np.complex64)
        moving = np.empty((6, self.s.size), dtype=np.complex64)
        moving.real, moving.imag = motion.moving[:, : self.s.size], motion.moving[:, self.s.size :]
        moving *= inverse
        whole[:6], whole[6:] = grid.envelopes(moving), drive
        return Signals(grid, whole)

    @cached_property
    def pickoff_residues(self) -> ComplexArray:
        """R_k (3, S, D) [rad/s]."""
        m = self.mechanics
        read = m.velocity_sense[0] * self.poles[:, None, None] + m.position_sense[0]
        return np.asarray(read @ self.parts @ m.drive[0])

    def forced(self, forces: DeviceForces, grid: Grid, out: FloatArray) -> FloatArray:
        """Volts behind the filter in response to forces: the first rows of ``out`` (.., S, 2 W)."""
        m, rows = self.mechanics, forces.rows
        gain = grid.bin_scale * (
            (m.velocity_sense[0] * self.poles[:, None, None] + m.position_sense[0]) @ self.parts
        ).swapaxes(1, 2)
        respond(
            forces.transforms,
            rows,
            grid.below,
            forces.ringing,
            self.s.imag,
            real_parts(self.antialias).astype(np.float32),
            real_parts(self.poles),
            real_parts(gain).astype(np.float32),
            out[: rows.shape[0]],
        )
        return out[: rows.shape[0]]


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
def shared_signals(band: Band, grid: Grid) -> tuple[AnyComplexArray, ComplexArray]:
    """What devices of a band share: 1 / G (W,) in units of the grid, single precision, and envelopes (D, n) [V] of the drive."""
    _, antialias, drive = frequency_axis(band)
    inverse = (1.0 / (grid.bin_scale * antialias)).astype(np.complex64)
    return inverse, grid.envelopes(drive / grid.bin_scale)


@dataclass(frozen=True, eq=False)
class Moved:
    """First-order changes of the poles (k, 3) and residues (k, 3, S, D) [rad/s] between pairs of mechanics."""

    poles: ComplexArray
    residues: ComplexArray


#: Two mechanics (batches of one), and what of the first is changed.
Pair = tuple[Mechanics, Mechanics]


def _moved(modes: PositionModes, own: Mechanics, pairs: Sequence[Sequence[Pair]]) -> list[Moved]:
    """What the differences of k pairs of each device change, linearised at the mechanics ``own`` of B devices."""
    shape = len(pairs), len(pairs[0])

    def change(name: str) -> FloatArray | None:
        ends = [[(getattr(ahead, name), getattr(behind, name)) for ahead, behind in each] for each in pairs]
        if all(ahead is behind for each in ends for ahead, behind in each):
            return None
        return np.array([[ahead[0] - behind[0] for ahead, behind in each] for each in ends])

    state = np.zeros((*shape, 6, 6))
    for name, columns in (("stiffness", slice(0, 3)), ("damping", slice(3, 6)), ("gyroscopic", slice(3, 6))):
        if (moved := change(name)) is not None:
            state[:, :, 3:, columns] -= moved
    poles, parts = modes.moved(state)
    of_own, own_parts, drive = modes.poles[:, None, :, None, None], modes.parts[:, None], own.drive[:, None, None]
    reads = own.velocity_sense[:, None, None]
    read = reads * of_own + own.position_sense[:, None, None]
    residues = (reads * poles[..., None, None] @ own_parts + read @ parts) @ drive
    for name, factor in (("velocity_sense", of_own), ("position_sense", 1.0)):
        if (moved := change(name)) is not None:
            residues += (moved[:, :, None] * factor) @ own_parts @ drive
    if (moved := change("drive")) is not None:
        residues += read @ own_parts @ moved[:, :, None]
    return [Moved(*each) for each in zip(poles, residues)]


def linear_devices(
    fits: Sequence[Fit],
    bands: Sequence[Sequence[Band]],
    instrument: Instrument,
    others: Callable[[Mechanics, Context], Sequence[Pair]],
) -> list[tuple[tuple[LinearDevice, ...], Moved]]:
    """The linear device of each fit in the band of each record, and what pairs of ``others``, functions of its mechanics, change.

    All arithmetic acts on each device alone, so a device has the numbers that it has alone, bit for bit.

    Raises
    ------
    ConfigError : a mode does not oscillate, as in ``modes_of``.
    """
    mechanics, contexts = device_mechanics(np.stack([fit.x for fit in fits]), instrument.bias_v)
    modes = PositionModes.of(mechanics, np.stack([modes_at(fit.x)[0] for fit in fits]))
    alone = [mechanics.of(b) for b in range(len(fits))]
    moved = _moved(modes, mechanics, [others(own, context) for own, context in zip(alone, contexts)])
    found = []
    for fit, own_bands, own, context, poles, parts in zip(fits, bands, alone, contexts, modes.poles, modes.parts):
        expansion = fit.likelihood.expansion
        first, second = poles[:2]
        straight = abs(first - expansion[0]) + abs(second - expansion[1])
        crossed = abs(first - expansion[1]) + abs(second - expansion[0])
        source = (1, 0, 2) if crossed < straight else (0, 1, 2)
        shifts = poles - expansion[list(source)]
        found.append(
            tuple(
                LinearDevice(band, context, own, poles, parts, columns, shifts, source, *frequency_axis(band))
                for band, columns in zip(own_bands, fit.likelihood.columns)
            )
        )
    return list(zip(found, moved))
