"""The places of a batch of devices, and random numbers for each level of the hierarchy.

A random stream is identified by (irregularity, level, label) and the number k of the lot, wafer or device:

    SeedSequence(seed, spawn_key=(crc32("irregularity/level/label"), k))

so a draw depends only on the seed and these names, and a new irregularity changes no other draw.

Shapes: B devices, J springs, D dies per wafer.  Random numbers have the shape (size, B) with contiguous rows, because numpy's
elementary functions may round differently on strided memory and a device must not depend on its batch.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np

from pipeline.arrays import ComplexArray, FloatArray, IntArray

from .layout import Places, die_centres
from .nominal import NominalDevice, Operating, Wafer
from .symmetric import as_complex

Level = Literal["lot", "wafer", "die", "package"]


@lru_cache(maxsize=32)
def field_factor(wafer: Wafer, length_mm: float) -> FloatArray:
    """Cholesky factor (D, D) [1] of exp(-d / length) over the dies of a wafer; d and ``length_mm`` [mm]."""
    centres = die_centres(wafer)
    offset = centres[:, None, :] - centres[None, :, :]
    distance = np.hypot(offset[..., 0], offset[..., 1])
    factor: FloatArray = np.linalg.cholesky(np.exp(-distance / length_mm))
    factor.setflags(write=False)
    return factor


@dataclass(frozen=True, eq=False)
class Site:
    """The input of an irregularity: the nominal device, the place of each die, and random numbers [1].

    The same (level, label) always gives the same numbers.
    """

    irregularity: str
    seed: int
    index: IntArray
    places: Places
    device: NominalDevice
    wafer: Wafer
    operating: Operating

    def _generator(self, kind: str, key: int) -> np.random.Generator:
        stream = zlib.crc32(f"{self.irregularity}/{kind}".encode())
        return np.random.Generator(np.random.PCG64(np.random.SeedSequence(self.seed, spawn_key=(stream, key))))

    def _numbers(self, level: Level) -> IntArray:
        return {"lot": self.places.lot, "wafer": self.places.wafer}.get(level, self.index)

    def normal(self, level: Level, size: int = 1, label: str = "") -> FloatArray:
        """Standard normals (size, B) [1]; at level "lot" or "wafer", devices of the same lot or wafer share them."""
        keys, back = np.unique(self._numbers(level), return_inverse=True)
        drawn = np.empty((size, len(keys)))
        for column, key in enumerate(keys.tolist()):
            drawn[:, column] = self._generator(f"{level}/{label}", key).standard_normal(size)
        return np.take(drawn, back, axis=1)

    def fixed(self, size: int = 1, label: str = "") -> FloatArray:
        """Standard normals (size,) [1], the same for all devices of the seed."""
        return self._generator(f"fixed/{label}", 0).standard_normal(size)

    def uniform(self, level: Level, label: str = "") -> FloatArray:
        """Uniform numbers (B,) [1] in [0, 1)."""
        keys, back = np.unique(self._numbers(level), return_inverse=True)
        drawn = np.array([self._generator(f"{level}/{label}/uniform", key).random() for key in keys.tolist()])
        return np.take(drawn, back)

    def complex_normal(self, level: Level, label: str = "") -> ComplexArray:
        """A 2-theta quantity (B,) [1] without preferred axis: a complex normal with unit sd in each component."""
        real, imaginary = self.normal(level, 2, label)
        return as_complex(real, imaginary)

    def field(self, length_mm: float) -> FloatArray:
        """Gaussian process (B,) [1] on each wafer: unit variance, correlation exp(-d / length), lengths [mm]."""
        factor = field_factor(self.wafer, length_mm)
        keys, back = np.unique(self.places.wafer, return_inverse=True)
        # One product per wafer: the rounding of BLAS depends on the shape of the matrices.
        maps = [factor @ self._generator("wafer/field", key).standard_normal(len(factor)) for key in keys.tolist()]
        return np.ascontiguousarray(np.stack(maps)[back, self.places.die])

    def spring_azimuth(self) -> FloatArray:
        """Nominal azimuths (J, 1) [rad] of the springs."""
        return np.deg2rad(np.array(self.device.spring_azimuth_deg))[:, None]

    def spring_places(self) -> tuple[FloatArray, FloatArray]:
        """x and y (J, B) of the springs on the wafer [wafer radius]."""
        azimuth, radius = self.spring_azimuth(), self.wafer.diameter_mm / 2.0
        r = self.device.spring_radius * self.device.arm_mm
        return (self.places.x_mm + r * np.cos(azimuth)) / radius, (self.places.y_mm + r * np.sin(azimuth)) / radius
