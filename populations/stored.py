"""Devices from the numbers that they were drawn with, under the same or another population.

The same numbers under changed spreads, means or bows give the devices that the changed process would have made of them: the
difference between the two populations is then free of the scatter of independent draws (common random numbers).

Shapes: B devices, d numbers per device (the order of ``latent.latent_space`` without the die).
Source: Owen, Monte Carlo theory, methods and examples (2013), 8.6.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pipeline.arrays import FloatArray, IntArray
from pipeline.errors import ConfigError, UsageError

from .draw import Draw, draw_with
from .drawn import NumberName, number_name
from .latent import LatentNumbers, LatentSpace, latent_space
from .layout import places
from .nominal import Wafer
from .spec import PopulationSpec

DIE = "wafer/die"


@dataclass(frozen=True, eq=False)
class StoredNumbers(LatentNumbers):
    """Numbers of B devices as they were drawn: as latent ones, but for a field, whose value at the die itself is stored."""

    def field(self, stream: str, keys: IntArray, die: IntArray, wafer: Wafer, length_mm: float) -> FloatArray:
        """The stored field of ``length_mm`` at each die, (B,) [1]."""
        lengths = self.space.lengths.get(stream, ())
        if length_mm not in lengths:
            raise ConfigError(
                "a random field was not stored with this correlation length",
                value=f"{stream}, {length_mm:g} mm",
                allowed=", ".join(f"{length:g} mm" for length in lengths) or "no field",
                next_step="change another parameter; a new run shows the change of a length",
            )
        return np.ascontiguousarray(self.z[self.space.first[stream] + lengths.index(length_mm)])


def number_names(spec: PopulationSpec) -> tuple[NumberName, ...]:
    """Names of the numbers (d,) that a device of the population is drawn with."""
    space = latent_space(spec)
    return tuple(
        number_name(stream, component)
        for stream, size in space.size.items()
        if stream != DIE
        for component in range(size)
    )


def draw_stored(spec: PopulationSpec, changed: PopulationSpec, index: IntArray, values: FloatArray, seed: int) -> Draw:
    """The devices ``index`` (B,) that ``changed`` makes of the numbers ``values`` (B, d), which ``spec`` drew with ``seed``.

    Raises
    ------
    UsageError : ``values`` has another number of columns than ``spec`` has numbers.
    ConfigError : as :func:`populations.draw.draw`; ``changed`` reads numbers that were not stored.
    """
    space: LatentSpace = latent_space(spec)
    if values.shape != (len(index), space.dimension - 1):
        allowed = f"({len(index)}, {space.dimension - 1})"
        raise UsageError("the stored numbers are not those of the population", value=values.shape, allowed=allowed)
    rows = np.zeros((space.dimension, len(index)))
    rows[np.arange(space.dimension) != space.first[DIE]] = values.T
    return draw_with(changed, index, places(changed.wafer, index), StoredNumbers(space, rows, seed))
