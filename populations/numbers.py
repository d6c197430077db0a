"""Where the random numbers of an irregularity come from.

:class:`SeededNumbers` draws them from named streams, for numbered devices; ``latent`` reads them from a vector of standard
normals, for devices that a sampling method chooses.

A stream is named "irregularity/level/label".  Shapes: B devices, D dies per wafer.  Random numbers have the shape (size, B)
with contiguous rows, because numpy's elementary functions may round differently on strided memory and a device must not depend
on its batch.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol

import numpy as np

from pipeline.arrays import FloatArray, IntArray

from .layout import die_centres
from .nominal import Wafer


@lru_cache(maxsize=32)
def field_factor(wafer: Wafer, length_mm: float) -> FloatArray:
    """Cholesky factor (D, D) [1] of exp(-d / length) over the dies of a wafer; d and ``length_mm`` [mm]."""
    centres = die_centres(wafer)
    offset = centres[:, None, :] - centres[None, :, :]
    distance = np.hypot(offset[..., 0], offset[..., 1])
    factor: FloatArray = np.linalg.cholesky(np.exp(-distance / length_mm))
    factor.setflags(write=False)
    return factor


class Numbers(Protocol):
    """Random numbers by stream and by the numbers (B,) of the lots, wafers or devices that they belong to."""

    def normal(self, stream: str, keys: IntArray, size: int) -> FloatArray:
        """Standard normals (size, B) [1]; equal keys share them."""

    def uniform(self, stream: str, keys: IntArray) -> FloatArray:
        """Uniform numbers (B,) [1] in [0, 1); equal keys share them."""

    def fixed(self, stream: str, size: int) -> FloatArray:
        """Standard normals (size,) [1], the same for all devices."""

    def field(self, stream: str, keys: IntArray, die: IntArray, wafer: Wafer, length_mm: float) -> FloatArray:
        """Gaussian process (B,) [1] at the dies (B,) of the wafers ``keys`` (B,): unit variance, correlation exp(-d / length)."""


@dataclass(frozen=True)
class SeededNumbers:
    """Numbers of the random streams SeedSequence(seed, spawn_key=(crc32(stream), key)): they depend on these names only."""

    seed: int

    def _generator(self, stream: str, key: int) -> np.random.Generator:
        spawn_key = (zlib.crc32(stream.encode()), key)
        return np.random.Generator(np.random.PCG64(np.random.SeedSequence(self.seed, spawn_key=spawn_key)))

    def normal(self, stream: str, keys: IntArray, size: int) -> FloatArray:
        """Standard normals (size, B) [1]; equal keys share them."""
        own, back = np.unique(keys, return_inverse=True)
        drawn = np.empty((size, len(own)))
        for column, key in enumerate(own.tolist()):
            drawn[:, column] = self._generator(stream, key).standard_normal(size)
        return np.take(drawn, back, axis=1)

    def uniform(self, stream: str, keys: IntArray) -> FloatArray:
        """Uniform numbers (B,) [1] in [0, 1); equal keys share them."""
        own, back = np.unique(keys, return_inverse=True)
        drawn = np.array([self._generator(f"{stream}/uniform", key).random() for key in own.tolist()])
        return np.take(drawn, back)

    def fixed(self, stream: str, size: int) -> FloatArray:
        """Standard normals (size,) [1], the same for all devices."""
        return self._generator(stream, 0).standard_normal(size)

    def field(self, stream: str, keys: IntArray, die: IntArray, wafer: Wafer, length_mm: float) -> FloatArray:
        """Gaussian process (B,) [1] on each wafer."""
        factor = field_factor(wafer, length_mm)
        own, back = np.unique(keys, return_inverse=True)
        # One product per wafer: the rounding of BLAS depends on the shape of the matrices.
        maps = [factor @ self._generator(stream, key).standard_normal(len(factor)) for key in own.tolist()]
        return np.ascontiguousarray(np.stack(maps)[back, die])
