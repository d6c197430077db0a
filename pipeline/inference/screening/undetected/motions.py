"""Linear motions of several devices as envelopes, and at the phases of each point (``narrow_band``).

All arithmetic acts on each device alone, so a device has the numbers that it has alone, bit for bit.

Shapes: B devices, 3 coordinates, D drives, M phases, n points of the grid, n' of them that a law needs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ....arrays import FloatArray, IntArray, RealArray
from ....device.device_forces import DevicePoints, Elements
from .force_loops import loud_points, split_parts, weighted_sums
from .narrow_band import QUIET, Grid, Phases, Signals, waves


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
            split_parts(one.envelopes.view(np.float32), first, b, motion)
        split_parts(signals[0].envelopes[6:].view(np.float32), first, 0, drive)
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
