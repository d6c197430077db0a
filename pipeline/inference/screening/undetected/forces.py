"""Forces of laws along the linear motion of several devices, as envelopes in the band (``narrow_band``).

An odd law acts through its first harmonic.  One without a first harmonic acts in second order, through the deviation that its
other harmonics cause; its parameter then has a value that changes the motion by ``_SHARE``.

All arithmetic acts on each device alone, so a device has the forces that it has alone, bit for bit.

Shapes: B devices, K forces, R envelopes, 3 coordinates, D drives, M phases, n points of the grid, n' of them that a law needs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache

import numpy as np

from ....arrays import AnyComplexArray, FloatArray, IntArray, RealArray
from ....device.device_forces import DevicePoints, Elements, force_of_devices, laws_of_devices, takes_devices
from ....device.force_law import Laws, force_along, in_single
from ....device.gyro import M_D
from .force_loops import first_harmonic, loud_points, split_parts, sums_of_squares, weighted_sums
from .library import Probe, probes_of
from .linear import DeviceForces, LinearDevice
from .narrow_band import QUIET, WHOLE_TURN, Grid, Phases, Signals, waves
from .nonlinear import drive_force
from .parity import LawKind, kind_of
from .ringing import ringing

#: Relative change of the motion by a probe: second order is then 1e-8 of it, far above rounding and far below the signal.
_SHARE = 1e-4
_MOTION_D: FloatArray = np.ascontiguousarray(np.concatenate([M_D.T, np.ones((2, 1))], axis=1))

#: A force on each coordinate, (B, M, n') [V/s]; ``None`` where it does not act.
Force = list[RealArray | None]


@dataclass(frozen=True, eq=False)
class Motions:
    """Envelopes of devices, real parts before imaginary ones, at the points of one grid, in single precision.

    The order of the points is cyclic, so that those at which nonlinear forces count come first: a device rings to the end of the
    record, and its envelope beyond the jump to the start.

    Parameters
    ----------
    grid : the grid.
    first, loud : the point that comes first, and the number of points that contain all at which nonlinear forces count.
    motion : coordinates and velocities (3 + 3, B, 2, n) [V s, V].
    drive : of all devices (D, 1, 2, n) [V].
    fading, steady : what forces are multiplied by (B, n): 1 where nonlinear forces count, else 0; and 1.
    """

    grid: Grid
    first: int
    loud: int
    motion: RealArray
    drive: RealArray
    fading: RealArray
    steady: RealArray

    @classmethod
    def of(cls, signals: Sequence[Signals]) -> Motions:
        grid, drives = signals[0].grid, len(signals[0].envelopes) - 6
        shape = len(signals), grid.points
        loud = np.empty(shape, dtype=np.bool_)
        for own, one in zip(loud, signals):
            loud_points(one.velocities, np.float32(QUIET), own)
        first, count = _cyclic(np.flatnonzero(loud.any(axis=0)), grid.points)
        motion = np.empty((6, shape[0], 2, grid.points), dtype=np.float32)
        drive = np.empty((drives, 1, 2, grid.points), dtype=np.float32)
        for b, one in enumerate(signals):
            split_parts(one.envelopes, first, b, motion)
        split_parts(signals[0].envelopes[6:], first, 0, drive)
        fading = np.concatenate([loud[:, first:], loud[:, :first]], axis=1).astype(np.float32)
        return cls(grid, first, count, motion, drive, fading, np.ones(shape, dtype=np.float32))

    @property
    def devices(self) -> int:
        """B."""
        return self.motion.shape[1]

    def used(self, fades: bool) -> int:
        """n' for a law that ``fades`` or not."""
        return self.loud if fades else self.grid.points

    def time_s(self, fades: bool) -> FloatArray:
        """Times (n',) [s]."""
        return np.roll(self.grid.time_s, -self.first)[: self.used(fades)]

    def at(self, phases: Phases, fades: bool, single: bool) -> DevicePoints:
        """The motion at the phases of each point (B, M, n'), in ``single`` or double precision."""
        turns, count = waves(phases, (1,), single)[None], self.used(fades)

        def along(values: RealArray) -> RealArray:
            out = np.empty((values.shape[0], phases.count, count), dtype=turns.dtype)
            weighted_sums(values, turns, 0, True, out)
            return out

        return DevicePoints(
            self.time_s(fades).astype(turns.dtype),
            Elements(3, lambda i: along(self.motion[i])),
            Elements(3, lambda i: along(self.motion[3 + i])),
            Elements(self.drive.shape[0], lambda i: along(self.drive[i])),
            (self.devices, phases.count, count),
        )


def _cyclic(points: IntArray, size: int) -> tuple[int, int]:
    """The first and the number of the fewest points of a cyclic grid that follow each other and contain some ``points``."""
    if not points.size:
        return 0, 0
    gaps = np.diff(points, append=points[0] + size)
    widest = int(gaps.argmax())
    return int(points[(widest + 1) % points.size]), size + 1 - int(gaps[widest])


@lru_cache(maxsize=4)
def _kinds(with_mismatch: bool) -> tuple[tuple[Probe, LawKind], ...]:
    """The parameters of the force laws, those of second order last."""
    found = [(probe, kind_of(probe)) for probe in probes_of(with_mismatch, "force")]
    # What the drive alone makes at other harmonics does not mix with the motion.
    return tuple(sorted((one for one in found if not one[1].still), key=lambda one: one[1].order))


@dataclass(frozen=True, eq=False)
class _DeviceLaws:
    """Linear mechanics of each device as force laws see them: one by one, and together in both precisions."""

    each: tuple[Laws, ...]
    double: Laws
    single: Laws

    @classmethod
    def of(cls, devices: Sequence[LinearDevice]) -> _DeviceLaws:
        each = []
        for device in devices:
            m, c = device.mechanics, device.context
            damping, stiffness, drive = (np.ascontiguousarray(one[0]) for one in (m.damping, m.stiffness, m.drive))
            each.append(Laws(damping, stiffness, drive, _MOTION_D, c.bias_v, c.operating_bias_v, 2))
        double = laws_of_devices(each, 3)
        return cls(tuple(each), double, in_single(double))

    def along(self, probe: Probe, points: DevicePoints, p: RealArray) -> Force:
        """Force of a law with parameters (k,), or (k, B, M, n') of each device, in the precision of the points."""
        force, single = probe.effect.force, points.t.dtype == np.float32
        assert force is not None
        if takes_devices(force, probe.size):
            own = self.single if single else self.double
            return force_of_devices(force, points, p.astype(points.t.dtype, copy=False), own)
        alone = [
            force_along(force, points.of(b), p if p.ndim == 1 else np.ascontiguousarray(p[:, b, 0, 0]), laws)
            for b, laws in enumerate(self.each)
        ]
        return [np.stack(one).reshape(points.shape) for one in zip(*alone)]


@dataclass(frozen=True, eq=False)
class _Book:
    """Forces as they are found: parameters with values (B,) and orders, and the envelope (B, R, n) on each coordinate.

    A value is 0 where the force of a device is: it has no signature.
    """

    envelopes: AnyComplexArray
    probes: list[Probe]
    values: list[FloatArray]
    orders: list[int]
    rows: list[list[int]]

    @classmethod
    def empty(cls, devices: int, with_mismatch: bool, points: int) -> _Book:
        most = sum(len(kind.acts) for _, kind in _kinds(with_mismatch)) + 3 * len(probes_of(with_mismatch, "drive"))
        return cls(np.empty((devices, most, points), dtype=np.complex64), [], [], [], [])

    def enter(self, probe: Probe, values: FloatArray, order: int, acts: Sequence[bool]) -> list[int]:
        """Enter a force that acts on some coordinates; the numbers of its envelopes, -1 for the others."""
        first = sum(row >= 0 for own in self.rows for row in own)
        self.probes.append(probe)
        self.values.append(values)
        self.orders.append(order)
        self.rows.append([first + sum(acts[:c]) if act else -1 for c, act in enumerate(acts)])
        return self.rows[-1]

    def write(
        self, probe: Probe, values: FloatArray, order: int, force: Force, phases: Phases, counted: RealArray, first: int
    ) -> None:
        """Enter a force by its first harmonic."""
        rows = self.enter(probe, values, order, [one is not None for one in force])
        for row, one in zip(rows, force):
            if one is not None:
                turns = _first(phases, one.dtype == np.float32)
                first_harmonic(one, turns, counted, first, self.envelopes[:, row])

    def of_each(self, devices: Sequence[LinearDevice], grid: Grid) -> list[DeviceForces]:
        """The forces of each device; their envelopes become transforms."""
        every: IntArray = np.array(self.rows, dtype=np.int64).reshape(-1, 3)
        left = ringing(devices, grid, self.envelopes, every)
        found = []
        for b, own in enumerate(self.envelopes[:, : int(every.max(initial=-1)) + 1]):
            acting = [k for k, values in enumerate(self.values) if values[b] != 0.0]
            found.append(
                DeviceForces(
                    [self.probes[k] for k in acting],
                    [float(self.values[k][b]) for k in acting],
                    [self.orders[k] for k in acting],
                    every[acting],
                    grid.transforms(own, overwrite=True),
                    left[b, acting],
                )
            )
        return found


def forces_of(
    devices: Sequence[LinearDevice],
    signals: Sequence[Signals],
    sizes: Sequence[Mapping[str, float]],
    with_mismatch: bool,
) -> list[DeviceForces]:
    """The force of each parameter of the drive and force laws, along the linear motion of each device.

    Parameters
    ----------
    devices, signals : of the same band and bias, and their envelopes.
    sizes : of clipping, of each device (``clipping.drive_sizes``).
    with_mismatch : whether the fits have electrode mismatches.
    """
    laws, motions, grid = _DeviceLaws.of(devices), Motions.of(signals), signals[0].grid
    count = motions.devices
    book = _Book.empty(count, with_mismatch, grid.points)
    at: dict[tuple[Phases, bool, bool], DevicePoints] = {}
    deviations: _SecondOrder | None = None
    for probe, kind in _kinds(with_mismatch):
        # Forces of second order are needed where nonlinear forces count.
        fades = kind.fades or kind.order == 2
        key = kind.phases, fades, kind.single
        own = at[key] = at.get(key) or motions.at(*key)
        force = _acting(laws.along(probe, own, probe.at(probe.member.scale)), kind)
        values, phases = np.full(count, probe.member.scale), kind.phases
        if kind.order == 2:
            if all(one is None for one in force):
                continue
            deviations = deviations or _SecondOrder.of(devices, motions)
            shares, moved = deviations.by(force)
            values, phases = values * shares, WHOLE_TURN
            p = np.zeros((probe.size, count, 1, 1))
            p[:] = probe.at(0.0).reshape(-1, 1, 1, 1)
            p[probe.i] = values[:, None, None]
            force = _acting(laws.along(probe, moved, np.broadcast_to(p, (probe.size, *moved.shape))), kind)
        counted = motions.fading if fades else motions.steady
        book.write(probe, values, kind.order, force, phases, counted, motions.first)
    for probe in probes_of(with_mismatch, "drive"):
        own_forces = [drive_force(device, grid, probe, size) for device, size in zip(devices, sizes)]
        if any(one is not None for one in own_forces):
            values = np.array([0.0 if one is None else one[0] for one in own_forces])
            start, *_ = book.enter(probe, values, 1, [True] * 3)
            for out, one in zip(book.envelopes, own_forces):
                out[start : start + 3] = 0.0 if one is None else one[1]
    return book.of_each(devices, grid)


def _acting(force: Force, kind: LawKind) -> Force:
    return [one if c in kind.acts else None for c, one in enumerate(force)]


@cache
def _first(phases: Phases, single: bool) -> RealArray:
    """What turns a force at phases into its first harmonic (1, M, 2), in ``single`` or double precision."""
    return np.ascontiguousarray(waves(phases, (1,), single).T[None]) * (2.0 / phases.count)


#: What turns a force at the phases of :data:`WHOLE_TURN` into Re f_2, Im f_2 and f_0, (1, M, 3).
_EVEN: RealArray = np.ascontiguousarray(waves(WHOLE_TURN, (2, 0), True)[None, :3].swapaxes(1, 2)) * (
    2.0 / WHOLE_TURN.count
)
_DOUBLE: FloatArray = waves(WHOLE_TURN, (2, 0), False)
#: What turns Re d_2, Im d_2 and d_0 / 2 of a deviation into it at the phases, and into its velocity over 2 w0, (2, 3, M).
_DEVIATED: FloatArray = np.stack([_DOUBLE[[0, 1, 2]], _DOUBLE[[1, 0, 3]] * [[1.0], [-1.0], [0.0]]])


@dataclass(frozen=True, eq=False)
class _SecondOrder:
    """What the motions with a deviation of second order need.

    Parameters
    ----------
    motions, plain : the motions without it, and at the phases of :data:`WHOLE_TURN`, in double precision.
    gains : (K - 4 w0^2)^-1 twice and K^-1 / 2 (B, 3, 3, 3) [s^2], by force and part: of Re f_2, Im f_2 and f_0.
    level : root of the sum of squares of the loud envelopes (B,) [V s].
    """

    motions: Motions
    plain: DevicePoints
    gains: FloatArray
    level: FloatArray

    @classmethod
    def of(cls, devices: Sequence[LinearDevice], motions: Motions) -> _SecondOrder:
        stiffness = np.stack([device.mechanics.stiffness[0] for device in devices])
        static, fast = np.linalg.inv(np.stack([stiffness, stiffness - 4.0 * motions.grid.omega**2 * np.eye(3)]))
        squares = sum(_squares(motions, motions.motion[i]).sum(axis=1) for i in range(3))
        gains = np.stack([fast, fast, 0.5 * static], axis=-1)
        return cls(motions, motions.at(WHOLE_TURN, True, False), gains, np.sqrt(squares))

    def by(self, force: Force) -> tuple[FloatArray, DevicePoints]:
        """Share (B,) of a force at :data:`WHOLE_TURN`, and the motion with the deviation that this share of it causes.

        The deviation is proportional to the force; the share is 0 where there is none.
        """
        motions, omega, (count, phases, points) = self.motions, self.motions.grid.omega, self.plain.shape
        acts = [c for c, one in enumerate(force) if one is not None]
        even = np.empty((count, 3 * len(acts), points), dtype=np.float32)
        for k, c in enumerate(acts):
            weighted_sums(force[c], _EVEN.astype(force[c].dtype), 3 * k, True, even)
        by_part = _squares(motions, even).reshape(count, -1, 3)
        size = np.sqrt(np.maximum(by_part[:, :, 0] + by_part[:, :, 1], by_part[:, :, 2]).sum(axis=1))
        share = np.divide(_SHARE * omega**2 * self.level, size, out=np.zeros_like(size), where=size > 0.0)
        gains = self.gains[:, :, acts] * share[:, None, None, None]
        turns = waves(WHOLE_TURN, (1,), False)[None]

        def moved(channel: int, waves_of_even: FloatArray) -> RealArray:
            out = np.empty((count, phases, points))
            weights = (gains[:, channel % 3, :, :, None] * waves_of_even).reshape(count, -1, phases)
            weighted_sums(motions.motion[channel], turns, 0, True, out)
            weighted_sums(even, weights, 0, False, out)
            return out

        return share, replace(
            self.plain,
            q=Elements(3, lambda i: moved(i, _DEVIATED[0])),
            qd=Elements(3, lambda i: moved(3 + i, 2.0 * omega * _DEVIATED[1])),
        )


def _squares(motions: Motions, values: RealArray) -> FloatArray:
    """Sums (B, K) of the squares of values (B, K, >= n') where nonlinear forces count."""
    out = np.empty(values.shape[:2])
    sums_of_squares(values, motions.fading, motions.first, motions.loud, out)
    return out
