"""The places of a batch of devices, and random numbers for each level of the hierarchy.

A random number belongs to a stream "irregularity/level/label" and to the lot, wafer or device with number k, so a new
irregularity changes no other draw.  ``numbers`` says where the streams come from.

Shapes: B devices, J springs.  Random numbers have the shape (size, B).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from pipeline.arrays import ComplexArray, FloatArray, IntArray

from .layout import Places
from .nominal import NominalDevice, Operating, Wafer
from .numbers import Numbers
from .symmetric import as_complex

Level = Literal["lot", "wafer", "die", "package"]


@dataclass(frozen=True, eq=False)
class Site:
    """The input of an irregularity: the nominal device, the place of each die, and random numbers [1].

    The same (level, label) always gives the same numbers.
    """

    irregularity: str
    numbers: Numbers
    index: IntArray
    places: Places
    device: NominalDevice
    wafer: Wafer
    operating: Operating

    def _keys(self, level: Level) -> IntArray:
        return {"lot": self.places.lot, "wafer": self.places.wafer}.get(level, self.index)

    def normal(self, level: Level, size: int = 1, label: str = "") -> FloatArray:
        """Standard normals (size, B) [1]; at level "lot" or "wafer", devices of the same lot or wafer share them."""
        return self.numbers.normal(f"{self.irregularity}/{level}/{label}", self._keys(level), size)

    def fixed(self, size: int = 1, label: str = "") -> FloatArray:
        """Standard normals (size,) [1], the same for all devices of the seed."""
        return self.numbers.fixed(f"{self.irregularity}/fixed/{label}", size)

    def uniform(self, level: Level, label: str = "") -> FloatArray:
        """Uniform numbers (B,) [1] in [0, 1)."""
        return self.numbers.uniform(f"{self.irregularity}/{level}/{label}", self._keys(level))

    def complex_normal(self, level: Level, label: str = "") -> ComplexArray:
        """A 2-theta quantity (B,) [1] without preferred axis: a complex normal with unit sd in each component."""
        real, imaginary = self.normal(level, 2, label)
        return as_complex(real, imaginary)

    def field(self, length_mm: float) -> FloatArray:
        """Gaussian process (B,) [1] on each wafer: unit variance, correlation exp(-d / length), lengths [mm]."""
        stream = f"{self.irregularity}/wafer/field"
        return self.numbers.field(stream, self.places.wafer, self.places.die, self.wafer, length_mm)

    def spring_azimuth(self) -> FloatArray:
        """Nominal azimuths (J, 1) [rad] of the springs."""
        return np.deg2rad(np.array(self.device.spring_azimuth_deg))[:, None]

    def spring_places(self) -> tuple[FloatArray, FloatArray]:
        """x and y (J, B) of the springs on the wafer [wafer radius]."""
        azimuth, radius = self.spring_azimuth(), self.wafer.diameter_mm / 2.0
        r = self.device.spring_radius * self.device.arm_mm
        return (self.places.x_mm + r * np.cos(azimuth)) / radius, (self.places.y_mm + r * np.sin(azimuth)) / radius
