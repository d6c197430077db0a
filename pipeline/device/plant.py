"""Plants: the linear device without effects.

A plant has named parameters, mechanics, the motion of its electrodes, and smooth coordinates for fits.  (At zero split
``theta_deg`` and the damping ratios of the gyro are singular; the cartesian parameters are not.)
Shapes: n coordinates, S senses, D drives, P parameters.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property, lru_cache
from typing import Literal, Protocol

import numpy as np

from ..arrays import FloatArray
from .gyro import M_D, M_S, PHYSICAL, gyro_mechanics, to_cartesian, to_physical
from .mechanics import Mechanics
from .parameters import Parameter, Shape
from .scale import PAPER, Scale

C12 = "c12_per_s"
#: What a pick-off of a modal plant senses, by the order of the derivative of the motion.
Sense = Literal["displacement", "velocity", "acceleration"]
SENSES: tuple[Sense, ...] = ("displacement", "velocity", "acceleration")


class Plant(Protocol):
    """Interface of a plant.  ``names``: its parameters in order, followed by c12_per_s if the model has it."""

    @property
    def kinds(self) -> frozenset[str]:
        """Names by which effects declare that they apply to this plant."""
        ...

    @property
    def shape(self) -> Shape:
        """Numbers of senses and drives, and axes of nonlinear laws."""
        ...

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The parameters, in a fixed order."""
        ...

    def mechanics(self, values: Mapping[str, float]) -> Mechanics:
        """Mechanics (a batch of one) at parameter ``values`` by name, in the units that ``parameters`` declares."""
        ...

    def sense_motion(self) -> FloatArray:
        """Matrix (S, n) from the coordinates to the motion of the sense electrodes [V s]."""
        ...

    def drive_motion(self) -> FloatArray:
        """Matrix (D, n) from the coordinates to the motion of the drive electrodes [V s]."""
        ...

    def to_internal(self, physical: FloatArray) -> FloatArray:
        """Smooth coordinates (P,) from values (P,) of ``names`` [declared units]; each plant states the units."""
        ...

    def to_external(self, internal: FloatArray) -> FloatArray:
        """Values (P,) of ``names`` [declared units] from smooth coordinates (P,)."""
        ...

    def steps(self, internal: FloatArray) -> FloatArray:
        """Steps (P,) for central differences in the smooth coordinates, in their units."""
        ...


_GYRO_PARAMETERS = (
    Parameter("f1_hz", "Hz", 1.0, 1e6, "undamped frequency of the lower rocking axis"),
    Parameter("f2_hz", "Hz", 1.0, 1e6, "undamped frequency of the upper rocking axis"),
    Parameter("f3_hz", "Hz", 1.0, 1e6, "undamped frequency of the up-down mode"),
    Parameter("zeta1", "1", 0.0, 0.5, "damping ratio c11 / (2 omega1)"),
    Parameter("zeta2", "1", 0.0, 0.5, "damping ratio c22 / (2 omega2)"),
    Parameter("zeta3", "1", 0.0, 0.5, "damping ratio of the up-down mode"),
    Parameter("theta_deg", "deg", -90.0, 90.0, "angle of the lower-frequency stiffness axis from the x axis"),
    Parameter("rocking_gain", "1/s", 0.0, 1e6, "drive volts to rocking motion in pick-off volts"),
    Parameter("updown_gain", "1/s", 0.0, 1e6, "drive volts to up-down motion in pick-off volts"),
    Parameter("sense_imbalance", "1", -0.99, 0.99, "(K_S2 - K_S1)/(K_S2 + K_S1)"),
    Parameter("drive_imbalance", "1", -0.99, 0.99, "(K_D2 - K_D1)/(K_D2 + K_D1)"),
)
_GYRO_SHAPE = Shape(2, 2, ("x", "y"))
_WITHOUT_C12 = tuple(i for i, name in enumerate(PHYSICAL) if name != C12)


@lru_cache(maxsize=64)
def _gyro_mechanics(physical: tuple[float, ...]) -> Mechanics:
    """Kept, because finite differences of the parameters of effects ask for the same plant again."""
    return gyro_mechanics(np.array([physical]))


@dataclass(frozen=True)
class GyroPlant:
    """The gyro of the paper: eleven parameters, two drives, two senses; without c12 the damping axes are the stiffness axes.

    Smooth coordinates (``pipeline.device.gyro``): omega0, eps_c, eps_s, c0, then d_c, d_s with c12 or delta = (c11 - c22)/2
    without c12, then omega3, c33, ln G_r, ln G_z, s, d.
    """

    kinds: frozenset[str] = frozenset({"gyro"})
    shape: Shape = _GYRO_SHAPE
    parameters: tuple[Parameter, ...] = _GYRO_PARAMETERS

    def mechanics(self, values: Mapping[str, float]) -> Mechanics:
        """Mechanics in (psi_x, psi_y, z) with c12 = 0; the effect offdiagonal_damping adds c12."""
        kept = _gyro_mechanics(tuple(0.0 if name == C12 else values[name] for name in PHYSICAL))
        return Mechanics(*(getattr(kept, field.name).copy() for field in fields(kept)))

    def sense_motion(self) -> FloatArray:
        """(2, 3) [1]: x = M_S psi + z [V s], M_S of the paper, eq. (10)."""
        return np.concatenate([M_S, np.ones((2, 1))], axis=1)

    def drive_motion(self) -> FloatArray:
        """(2, 3) [1]: x = M_D^T psi + z [V s], M_D of the paper, eq. (9)."""
        return np.concatenate([M_D.T, np.ones((2, 1))], axis=1)

    def to_internal(self, physical: FloatArray) -> FloatArray:
        """Cartesian parameters (12,) with c12, or the smooth coordinates (11,) without c12 [rad/s, 1/s, 1]."""
        full = np.zeros(12)
        full[list(_WITHOUT_C12)] = physical[:11]
        if physical.size == 12:
            full[PHYSICAL.index(C12)] = physical[11]
        x = to_cartesian(full[None])[0]
        if physical.size == 12:
            return np.asarray(x)
        double = np.deg2rad(2.0 * full[PHYSICAL.index("theta_deg")])
        delta = x[4] * np.cos(double) + x[5] * np.sin(double)
        return np.concatenate([x[:4], [delta], x[6:]])

    def to_external(self, internal: FloatArray) -> FloatArray:
        """The inverse of :meth:`to_internal`: (12,) or (11,) values [declared units]."""
        if internal.size == 12:
            physical = to_physical(internal[None])[0]
            return np.append(physical[list(_WITHOUT_C12)], physical[PHYSICAL.index(C12)])
        split = np.hypot(internal[1], internal[2])
        axis = -internal[1:3] / split if split > 0.0 else np.array([1.0, 0.0])
        x = np.concatenate([internal[:4], internal[4] * axis, internal[5:]])
        return np.asarray(to_physical(x[None])[0][list(_WITHOUT_C12)])

    def steps(self, internal: FloatArray) -> FloatArray:
        """(P,): 1e-4 [rad/s, 1/s], 1e-5 for gains and imbalances; a resonance is about 1 rad/s wide, a record 1 s long."""
        return np.array([1e-4] * (internal.size - 4) + [1e-5] * 4)


@dataclass(frozen=True)
class ModalPlant:
    """H(s) = sum_k B_k s^m / (s^2 + 2 zeta_k omega_k s + omega_k^2), m = 0, 1, 2 for pick-offs of displacement, velocity, ..

    B_k (S, D) = gain<k>_s<a>d<b> [1/s^2, 1/s, 1].  Coordinates q_(k,a), one for each mode and sense: row a of
    B_k drives it, and only sense a measures it.
    """

    modes: int
    sense: Sense
    senses: int = 1
    drives: int = 1
    scale: Scale = PAPER

    @property
    def kinds(self) -> frozenset[str]:
        """{"modal"}, and "resonator" if there is one sense and at most one drive."""
        return frozenset({"modal", "resonator"} if self.senses == 1 and self.drives <= 1 else {"modal"})

    @cached_property
    def shape(self) -> Shape:
        """One axis for each coordinate; a single coordinate has the suffix x, as in the gyro."""
        n = self.modes * self.senses
        axes = ("x",) if n == 1 else tuple(f"_{i + 1}" for i in range(n))
        return Shape(self.senses, self.drives, axes, self.scale)

    @property
    def derivative(self) -> int:
        """m: the pick-offs sense the m-th derivative of the motion."""
        return SENSES.index(self.sense)

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """Frequency, damping ratio and gains, mode by mode."""
        unit = ("1/s^2", "1/s", "1")[self.derivative]
        out: list[Parameter] = []
        for k in range(1, self.modes + 1):
            out += [
                Parameter(f"f{k}_hz", "Hz", 0.0, 1e9, f"undamped frequency of mode {k}"),
                Parameter(f"zeta{k}", "1", 0.0, 0.99, f"damping ratio of mode {k}"),
            ]
            for a in range(1, self.senses + 1):
                for b in range(1, self.drives + 1):
                    meaning = f"drive {b} to sense {a} in mode {k}"
                    out.append(Parameter(f"gain{k}_s{a}d{b}", unit, -1e12, 1e12, meaning))
        return tuple(out)

    def mechanics(self, values: Mapping[str, float]) -> Mechanics:
        """Mechanics with diagonal C and K."""
        n = self.modes * self.senses
        damping, stiffness = np.zeros((1, n, n)), np.zeros((1, n, n))
        drive, sense = np.zeros((1, n, self.drives)), np.zeros((1, self.senses, n))
        for k in range(self.modes):
            omega = 2.0 * np.pi * values[f"f{k + 1}_hz"]
            for a in range(self.senses):
                i = k * self.senses + a
                damping[0, i, i], stiffness[0, i, i] = 2.0 * values[f"zeta{k + 1}"] * omega, omega**2
                drive[0, i] = [values[f"gain{k + 1}_s{a + 1}d{b + 1}"] for b in range(self.drives)]
                sense[0, a, i] = 1.0
        position, velocity, acceleration = (sense if m == self.derivative else np.zeros_like(sense) for m in range(3))
        return Mechanics(damping, np.zeros((1, n, n)), stiffness, drive, velocity, position, acceleration)

    def sense_motion(self) -> FloatArray:
        """(S, n) [1]: each sense measures the sum of its own coordinates."""
        return np.tile(np.eye(self.senses), (1, self.modes))

    def drive_motion(self) -> FloatArray:
        """Zeros (D, n): the motion of the drive electrodes is unknown, and effects that need it do not apply."""
        return np.zeros((self.drives, self.modes * self.senses))

    def to_internal(self, physical: FloatArray) -> FloatArray:
        """The identity on (P,): frequency [Hz], damping ratio [1] and gains [1/s^2, 1/s or 1] are smooth coordinates."""
        return physical

    def to_external(self, internal: FloatArray) -> FloatArray:
        """The identity on (P,), units as in :meth:`to_internal`."""
        return internal

    def steps(self, internal: FloatArray) -> FloatArray:
        """(P,): 1e-4 of the half width [Hz] for f, 1e-4 of zeta, and 1e-4 of the largest gain of the mode for all its gains."""
        width = 2 + self.senses * self.drives
        rows = internal.reshape(self.modes, width)
        out = np.empty_like(rows)
        out[:, 0] = 1e-4 * np.maximum(np.abs(rows[:, 1]), 1e-7) * rows[:, 0]
        out[:, 1] = 1e-4 * np.maximum(np.abs(rows[:, 1]), 1e-7)
        out[:, 2:] = 1e-4 * np.maximum(np.max(np.abs(rows[:, 2:]), axis=1, keepdims=True, initial=0.0), 1e-12)
        return out.reshape(-1)


@dataclass(frozen=True)
class PlantSpec:
    """A choice of plant: "gyro", or "modal" with its number of modes, kind of pick-off and ``senses`` x ``drives`` channels.

    ``scale`` is what the ranges of effects are relative to; ``None``: not known yet, as for the gyro of the paper.
    """

    kind: Literal["gyro", "modal"] = "gyro"
    modes: int = 1
    sense: Sense = "velocity"
    senses: int = 1
    drives: int = 1
    scale: Scale | None = None

    def build(self) -> Plant:
        """The plant object."""
        if self.kind == "gyro":
            return GyroPlant(shape=replace(_GYRO_SHAPE, scale=self.scale or PAPER))
        return ModalPlant(self.modes, self.sense, self.senses, self.drives, self.scale or PAPER)
