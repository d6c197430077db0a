"""A device like the paper's, on which the stages of a user's effect are tried out before they are used."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from .effect import Context, Effect
from .force_law import Laws
from .mechanics import Mechanics
from .parameters import Shape
from .plant import PlantSpec

#: Parameters of a device like that of the paper, each in its unit.
GYRO = {
    "f1_hz": 534.5,
    "f2_hz": 536.4,
    "f3_hz": 590.3,
    "zeta1": 3.2e-4,
    "zeta2": 1.6e-4,
    "zeta3": 1.2e-3,
    "theta_deg": -33.2,
    "rocking_gain": 13.0,
    "updown_gain": 29.0,
    "sense_imbalance": 0.04,
    "drive_imbalance": 0.001,
}
_MODAL = {"f1_hz": 534.5, "zeta1": 3.2e-4, "gain1_s1d1": 13.0}


@dataclass(frozen=True, eq=False)
class Example:
    """A device for an effect, the effect's parameters (k,) at their null and at one scale from it.

    ``motion`` (D, n): motion of the drive electrodes per coordinate; ``axes``: coordinates that nonlinear laws act on.
    """

    shape: Shape
    context: Context
    mechanics: Mechanics
    motion: FloatArray
    axes: int
    null: FloatArray
    scale: FloatArray


@dataclass(frozen=True, eq=False)
class ForceInput:
    """Arguments of a force law but for its parameters: q, qd (n + own,), u (D,), laws; the device has ``n`` coordinates."""

    q: FloatArray
    qd: FloatArray
    u: FloatArray
    laws: Laws
    n: int
    own: int

    def parameters(self, p: FloatArray) -> FloatArray:
        """``p`` with the place of the first coordinate of the law's own, where it has any."""
        return np.append(p, self.n) if self.own else p


def example_of(effect: Effect) -> Example:
    """A gyro, or one mode where the effect applies to no gyro."""
    gyro = bool({"gyro", "updown"} & set(effect.plants))
    plant = PlantSpec().build() if gyro else PlantSpec("modal").build()
    values = GYRO if gyro else _MODAL
    members, axes = effect.members(plant.shape), len(plant.shape.axes)
    p = np.array([m.grid[len(m.grid) // 2] if m.grid else m.null for m in members])
    scale = p + np.array([0.0 if m.grid else m.scale for m in members])
    context = Context(5.0, 5.0, values, axes=axes)
    return Example(plant.shape, context, plant.mechanics(values), plant.drive_motion(), axes, p, scale)


def force_input(effect: Effect, example: Example) -> ForceInput:
    """A random state of the example, with the coordinates of the effect's own law appended."""
    device, n = example.mechanics, example.mechanics.stiffness.shape[1]
    own = example.axes * (1 + effect.memories) if effect.has_coordinates else 0
    damping, stiffness = (np.pad(one[0], (0, own)) for one in (device.damping, device.stiffness))
    drive, gap = np.pad(device.drive[0], ((0, own), (0, 0))), np.pad(example.motion, ((0, 0), (0, own)))
    laws = Laws(damping, stiffness, drive, gap, 5.0, 5.0, example.axes)
    return ForceInput(1e-4 * random(n + own), random(n + own), random(drive.shape[1]), laws, n, own)


def random(*shape: int) -> FloatArray:
    """Standard normal numbers, always the same."""
    return np.random.default_rng(0).standard_normal(shape)
