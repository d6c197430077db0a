"""Forces of laws along the linear motion of several devices, as envelopes in the band (``narrow_band``).

An odd law acts through its first harmonic.  One without a first harmonic acts in second order, through the deviation that its
other harmonics cause (``second_order``).

All arithmetic acts on each device alone, so a device has the forces that it has alone, bit for bit.

Shapes: B devices, K forces, R envelopes, 3 coordinates, D drives, M phases, n points of the grid, n' of them that a law needs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Any

import numpy as np

from ....arrays import AnyComplexArray, FloatArray, IntArray, RealArray
from ....device.device_forces import DevicePoints, force_of_devices, laws_of_devices, takes_devices
from ....device.force_law import Laws, force_along, in_single
from ....device.gyro import M_D
from .force_loops import first_harmonic
from .library import Probe, probes_of
from .linear import DeviceForces, LinearDevice
from .motions import Motions
from .narrow_band import WHOLE_TURN, Grid, Phases, Signals, waves
from .nonlinear import drive_force
from .parity import LawKind, kind_of
from .ringing import ringing
from .second_order import SecondOrder

_MOTION_D: FloatArray = np.ascontiguousarray(np.concatenate([M_D.T, np.ones((2, 1))], axis=1))

#: A force on each coordinate, (B, M, n') [V/s]; ``None`` where it does not act.
Force = list[RealArray | None]


@lru_cache(maxsize=4)
def _kinds(with_mismatch: bool) -> tuple[tuple[Probe, LawKind], ...]:
    """The parameters of the force laws, those that need the same points one after the other, those of second order last."""
    found = [(probe, kind_of(probe)) for probe in probes_of(with_mismatch, "force")]
    # What the drive alone makes at other harmonics does not mix with the motion.
    return tuple(
        sorted((one for one in found if not one[1].still), key=lambda one: (one[1].order, *_points_of(one[1])))
    )


def _points_of(kind: LawKind) -> tuple[bool, int, float, bool]:
    """Whether a law fades, its phases and its precision: laws with the same of these share the points of a motion."""
    # Forces of second order are needed where nonlinear forces count.
    return kind.fades or kind.order == 2, -kind.phases.count, kind.phases.turn, kind.single


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


@cache
def _first(phases: Phases, single: bool) -> RealArray:
    """What turns a force at phases into its first harmonic (1, M, 2), in ``single`` or double precision."""
    return np.ascontiguousarray(waves(phases, (1,), single).T[None]) * (2.0 / phases.count)


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
        parts = self.envelopes.view(np.float32)
        for row, one in zip(rows, force):
            if one is not None:
                turns = _first(phases, one.dtype == np.float32)
                first_harmonic(one, turns, counted, first, row, parts)

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
    points: tuple[Any, DevicePoints] | None = None
    deviations: SecondOrder | None = None
    for probe, kind in _kinds(with_mismatch):
        fades = _points_of(kind)[0]
        if points is None or points[0] != _points_of(kind):
            points = _points_of(kind), motions.at(kind.phases, fades, kind.single)
        force = _acting(laws.along(probe, points[1], probe.at(probe.member.scale)), kind)
        values, phases = np.full(count, probe.member.scale), kind.phases
        if kind.order == 2:
            if all(one is None for one in force):
                continue
            deviations = deviations or SecondOrder.of(devices, motions)
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
