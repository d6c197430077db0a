"""Plants: the linear device without effects.

A plant has named parameters, mechanics, the motion of its electrodes, and smooth coordinates for fits.  (At zero split
``theta_deg`` and the damping ratios of the gyro are singular; the cartesian parameters are not.)
Shapes: n coordinates, S senses, D drives, P parameters.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, Protocol

import numpy as np

from ..arrays import FloatArray
from .gyro_plant import C12, GYRO_SHAPE, GyroPlant
from .mechanics import Mechanics
from .parameters import Parameter, Shape
from .scale import PAPER, Scale

__all__ = ["C12", "SENSES", "GyroPlant", "ModalPlant", "Plant", "PlantSpec", "Sense"]

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
        """Values (.., P) of ``names`` [declared units] from smooth coordinates (.., P)."""
        ...

    def steps(self, internal: FloatArray) -> FloatArray:
        """Steps (P,) for central differences in the smooth coordinates, in their units."""
        ...


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
        """The identity on (.., P), units as in :meth:`to_internal`."""
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
    ``frame_deg`` and ``updown`` describe the electrodes of a gyro (:class:`GyroPlant`).
    """

    kind: Literal["gyro", "modal"] = "gyro"
    modes: int = 1
    sense: Sense = "velocity"
    senses: int = 1
    drives: int = 1
    scale: Scale | None = None
    frame_deg: tuple[float, float] = (0.0, 0.0)
    updown: bool = True

    def build(self) -> Plant:
        """The plant object."""
        if self.kind == "gyro":
            return GyroPlant(replace(GYRO_SHAPE, scale=self.scale or PAPER), self.frame_deg, self.updown)
        return ModalPlant(self.modes, self.sense, self.senses, self.drives, self.scale or PAPER)
