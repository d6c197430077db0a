"""Forces of laws along the linear motion of several devices, as envelopes in the band (``narrow_band``).

An odd law acts through its first harmonic.  One without a first harmonic acts in second order, through the deviation that its
other harmonics cause; its parameter then has a value that changes the motion by ``_SHARE``.

All arithmetic acts on each device alone, so a device has the forces that it has alone, bit for bit.

Shapes: B devices, K forces, R envelopes, 3 coordinates, D drives, M phases, n points of the grid.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from ....arrays import AnyComplexArray, BoolArray, FloatArray, IntArray, RealArray
from ....device.device_forces import DevicePoints, Elements, force_of_devices, laws_of_devices, takes_devices
from ....device.force_law import Laws, force_along, in_single
from ....device.gyro import M_D
from .library import FORCES, Probe, most_signatures, probes_of
from .linear import DeviceForces, LinearDevice
from .loops import first_harmonic
from .narrow_band import QUIET, WHOLE_TURN, Grid, Phases, Signals, waves
from .nonlinear import drive_force
from .parity import LawKind, kind_of

#: Relative change of the motion by a probe: second order is then 1e-8 of it, far above rounding and far below the signal.
_SHARE = 1e-4
_MOTION_D: FloatArray = np.ascontiguousarray(np.concatenate([M_D.T, np.ones((2, 1))], axis=1))

#: A force on each coordinate, (B, M, n) [V/s]; ``None`` where it does not act.
Force = list[RealArray | None]


@dataclass(frozen=True, eq=False)
class Motions:
    """Envelopes of devices, real parts before imaginary ones, at the points of one grid.

    Parameters
    ----------
    grid : the grid.
    motion : coordinates and velocities (3 + 3, B, 2, n) [V s, V], in single precision.
    drive : of all devices (D, 1, 2, n) [V], in single precision.
    loud : (B, n) whether nonlinear forces count.
    """

    grid: Grid
    motion: RealArray
    drive: RealArray
    loud: BoolArray

    @classmethod
    def of(cls, signals: Sequence[Signals]) -> Motions:
        envelopes = np.stack([one.envelopes for one in signals], axis=1)
        parts = np.stack([envelopes.real, envelopes.imag], axis=2)
        velocities = parts[3:6]
        size = np.sqrt(velocities[:, :, 0] ** 2 + velocities[:, :, 1] ** 2).sum(axis=0)
        return cls(signals[0].grid, parts[:6], parts[6:, :1], size > QUIET * size.max(axis=1, keepdims=True))

    @property
    def shape(self) -> tuple[int, int]:
        """(B, n)."""
        return self.motion.shape[1], self.motion.shape[3]

    @cached_property
    def double(self) -> FloatArray:
        """Coordinates, velocities and drives as ``motion`` and ``drive``, in double precision."""
        return self.motion.astype(np.float64)

    def counted(self, fades: bool, single: bool) -> RealArray:
        """1 where a force counts, 0 elsewhere (B, n)."""
        kind = np.float32 if single else np.float64
        return self.loud.astype(kind) if fades else np.ones(self.shape, dtype=kind)

    def at(self, phases: Phases, single: bool) -> DevicePoints:
        """The motion at the phases of each point (B, M, n), in ``single`` or double precision."""
        turns = np.ascontiguousarray(waves(phases, (1,), single).T)
        motion, drive = (self.motion, self.drive) if single else (self.double, self.drive.astype(np.float64))
        return DevicePoints(
            self.grid.time_s.astype(turns.dtype),
            Elements(3, lambda i: turns @ motion[i]),
            Elements(3, lambda i: turns @ motion[3 + i]),
            Elements(drive.shape[0], lambda i: turns @ drive[i]),
            (self.shape[0], phases.count, self.shape[1]),
        )


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
        """Force of a law with parameters (k,), or (k, B, M, n) of each device, in the precision of the points."""
        force, single = probe.effect.force, points.t.dtype == np.float32
        assert force is not None
        if takes_devices(force, probe.size):
            own = self.single if single else self.double
            return force_of_devices(force, points, p.astype(points.t.dtype), own)
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

    def enter(self, probe: Probe, values: FloatArray, order: int, acts: Sequence[bool]) -> list[int]:
        """Enter a force that acts on some coordinates; the numbers of its envelopes, -1 for the others."""
        first = sum(row >= 0 for own in self.rows for row in own)
        before = np.cumsum([0, *acts])
        self.probes.append(probe)
        self.values.append(values)
        self.orders.append(order)
        self.rows.append([first + int(before[c]) if act else -1 for c, act in enumerate(acts)])
        return self.rows[-1]

    def write(
        self, probe: Probe, values: FloatArray, order: int, force: Force, phases: Phases, counted: RealArray
    ) -> None:
        """Enter a force by its first harmonic."""
        turns = waves(phases, (1,), counted.dtype == np.float32) * (2.0 / phases.count)
        for row, one in zip(self.enter(probe, values, order, [one is not None for one in force]), force):
            if one is not None:
                first_harmonic(one, turns, counted, self.envelopes[:, row])

    def of(self, device: int) -> DeviceForces:
        """The forces of one device."""
        acting = [k for k, values in enumerate(self.values) if values[device] != 0.0]
        rows: IntArray = np.array([self.rows[k] for k in acting], dtype=np.int64).reshape(-1, 3)
        return DeviceForces(
            [self.probes[k] for k in acting],
            [float(self.values[k][device]) for k in acting],
            [self.orders[k] for k in acting],
            rows,
            self.envelopes[device, : int(rows.max(initial=-1)) + 1],
        )


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
    laws, motions = _DeviceLaws.of(devices), Motions.of(signals)
    count, points = motions.shape
    envelopes = np.empty((count, 3 * most_signatures(with_mismatch, FORCES), points), dtype=np.complex64)
    book = _Book(envelopes, [], [], [], [])
    at: dict[tuple[Phases, bool], DevicePoints] = {}
    deviations: _SecondOrder | None = None
    for probe, kind in _kinds(with_mismatch):
        key = kind.phases, kind.single
        own = at[key] = at.get(key) or motions.at(*key)
        found = laws.along(probe, own, probe.at(probe.member.scale))
        force = [one if c in kind.acts else None for c, one in enumerate(found)]
        if kind.order == 1:
            values = np.full(count, probe.member.scale)
            book.write(probe, values, 1, force, kind.phases, motions.counted(kind.fades, kind.single))
        elif any(one is not None for one in force):
            deviations = deviations or _SecondOrder.of(devices, motions)
            values, moved = deviations.by(force, own)
            values *= probe.member.scale
            p = np.zeros((probe.size, count, 1, 1))
            p[:] = probe.at(0.0).reshape(-1, 1, 1, 1)
            p[probe.i] = values[:, None, None]
            force = laws.along(probe, moved, np.broadcast_to(p, (probe.size, *moved.shape)))
            book.write(probe, values, 2, force, WHOLE_TURN, motions.counted(True, False))
    for probe in probes_of(with_mismatch, "drive"):
        own_forces = [drive_force(device, one.grid, probe, size) for device, one, size in zip(devices, signals, sizes)]
        if any(one is not None for one in own_forces):
            values = np.array([0.0 if one is None else one[0] for one in own_forces])
            first, *_ = book.enter(probe, values, 1, [True] * 3)
            for out, one in zip(envelopes, own_forces):
                if one is not None:
                    out[first : first + 3] = one[1]
    return [book.of(b) for b in range(count)]


def _even(single: bool) -> RealArray:
    """What turns a force at the phases of :data:`WHOLE_TURN` into Re f_2, Im f_2 and f_0, (3, M)."""
    return waves(WHOLE_TURN, (2, 0), single)[:3] * (2.0 / WHOLE_TURN.count)


#: What turns Re a, Im a of a motion and Re d_2, Im d_2, d_0 of a deviation into the motion at the phases, (M, 5).
_DEVIATED: FloatArray = np.ascontiguousarray(
    np.concatenate([waves(WHOLE_TURN, (1, 2), False), np.ones((1, WHOLE_TURN.count))]).T
)


@dataclass(frozen=True, eq=False)
class _SecondOrder:
    """What the motions with a deviation of second order need.

    Parameters
    ----------
    motions : the motions without it.
    static, fast : K^-1 and (K - 4 w0^2)^-1 (B, 3, 3) [s^2].
    level : root of the sum of squares of the loud envelopes (B,) [V s].
    """

    motions: Motions
    static: FloatArray
    fast: FloatArray
    level: FloatArray

    @classmethod
    def of(cls, devices: Sequence[LinearDevice], motions: Motions) -> _SecondOrder:
        stiffness = np.stack([device.mechanics.stiffness[0] for device in devices])
        static, fast = np.linalg.inv(np.stack([stiffness, stiffness - 4.0 * motions.grid.omega**2 * np.eye(3)]))
        # One sum over all axes would depend on the number of devices.
        squares = (motions.double[:3] * motions.counted(True, False)[:, None]) ** 2
        return cls(motions, static, fast, np.sqrt(squares.sum(axis=-1).sum(axis=-1).sum(axis=0)))

    def by(self, force: Force, points: DevicePoints) -> tuple[FloatArray, DevicePoints]:
        """Share (B,) of a force at :data:`WHOLE_TURN`, and the motion with the deviation that this share of it causes.

        The deviation is proportional to the force; the share is 0 where there is none.
        """
        motions, omega = self.motions, self.motions.grid.omega
        single = points.t.dtype == np.float32
        acts = [c for c, one in enumerate(force) if one is not None]
        even = np.stack([_even(single) @ one for one in force if one is not None], axis=1)
        even *= motions.counted(True, single)[:, None, None]
        by_part = np.square(even).sum(axis=-1, dtype=np.float64)
        size = np.sqrt(np.maximum(by_part[:, :, 0] + by_part[:, :, 1], by_part[:, :, 2]).sum(axis=1))
        share = np.divide(_SHARE * omega**2 * self.level, size, out=np.zeros_like(size), where=size > 0.0)
        by_device = share[:, None, None]
        (count, n), kind = motions.shape, even.dtype
        fast, static = self.fast[..., acts] * by_device, self.static[..., acts] * (0.5 * by_device)
        double = (fast.astype(kind) @ even[:, :, :2].reshape(count, len(acts), -1)).reshape(count, 3, 2, n)
        steady = static.astype(kind) @ even[:, :, 2]

        def coordinate(i: int) -> RealArray:
            parts = np.concatenate([motions.double[i], double[:, i], steady[:, i, None]], axis=1)
            return np.asarray(_DEVIATED @ parts)

        def velocity(i: int) -> RealArray:
            turned = np.stack([-2.0 * omega * double[:, i, 1], 2.0 * omega * double[:, i, 0]], axis=1)
            return np.asarray(_DEVIATED[:, :4] @ np.concatenate([motions.double[3 + i], turned], axis=1))

        plain = motions.at(WHOLE_TURN, False)
        return share, DevicePoints(plain.t, Elements(3, coordinate), Elements(3, velocity), plain.u, plain.shape)
