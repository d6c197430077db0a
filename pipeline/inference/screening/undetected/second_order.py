"""The motion with the deviation that an even force causes, of several devices at once (``narrow_band``).

    d = Re{(K - 4 w0^2)^-1 f_2 e^{2 i w0 t}} + K^-1 f_0 / 2

All arithmetic acts on each device alone, so a device has the numbers that it has alone, bit for bit.

Shapes: B devices, 3 coordinates, M phases, n points of the grid, n' of them where nonlinear forces count.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ....arrays import FloatArray, RealArray
from ....device.device_forces import DevicePoints, Elements
from .force_loops import sums_of_squares, weighted_sums
from .linear import LinearDevice
from .motions import Motions
from .narrow_band import WHOLE_TURN, waves

#: Relative change of the motion by a probe: second order is then 1e-8 of it, far above rounding and far below the signal.
_SHARE = 1e-4
#: What turns a force at the phases of :data:`WHOLE_TURN` into Re f_2, Im f_2 and f_0, (1, M, 3).
_EVEN: RealArray = np.ascontiguousarray(waves(WHOLE_TURN, (2, 0), True)[None, :3].swapaxes(1, 2)) * (
    2.0 / WHOLE_TURN.count
)
_DOUBLE: FloatArray = waves(WHOLE_TURN, (2, 0), False)
#: What turns Re d_2, Im d_2 and d_0 / 2 of a deviation into it at the phases, and into its velocity over 2 w0, (2, 3, M).
_DEVIATED: FloatArray = np.stack([_DOUBLE[[0, 1, 2]], _DOUBLE[[1, 0, 3]] * [[1.0], [-1.0], [0.0]]])


@dataclass(frozen=True, eq=False)
class SecondOrder:
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
    def of(cls, devices: Sequence[LinearDevice], motions: Motions) -> SecondOrder:
        stiffness = np.stack([device.mechanics.stiffness[0] for device in devices])
        static, fast = np.linalg.inv(np.stack([stiffness, stiffness - 4.0 * motions.grid.omega**2 * np.eye(3)]))
        squares = sum(_squares(motions, motions.motion[i]).sum(axis=1) for i in range(3))
        gains = np.stack([fast, fast, 0.5 * static], axis=-1)
        return cls(motions, motions.at(WHOLE_TURN, True, False), gains, np.sqrt(squares))

    def by(self, force: Sequence[RealArray | None]) -> tuple[FloatArray, DevicePoints]:
        """Share (B,) of a force at :data:`WHOLE_TURN`, and the motion with the deviation that this share of it causes.

        The deviation is proportional to the force; the share is 0 where there is none.
        """
        motions, omega, (count, phases, points) = self.motions, self.motions.grid.omega, self.plain.shape
        acts = [c for c, one in enumerate(force) if one is not None]
        even = np.empty((count, 3 * len(acts), points), dtype=np.float32)
        for k, one in enumerate(one for one in force if one is not None):
            weighted_sums(one, _EVEN.astype(one.dtype), 3 * k, True, even)
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
