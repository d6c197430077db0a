"""The random numbers that a batch of devices was drawn with, as standard normals.

    normal z    as it is
    uniform u   Phi^-1(u)
    field N     its value at the die of the device, standard normal there; lengths in the order in which they were read
    fixed       not kept: all devices of a seed share them, so they explain no difference between devices

Shapes: B devices, d numbers per device.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.special import ndtri

from pipeline.arrays import FloatArray, IntArray

from .nominal import Wafer
from .numbers import Numbers

UNIFORM = "/uniform"


@dataclass(frozen=True)
class NumberName:
    """A number of a device: ``component`` of the numbers "irregularity/level/label"."""

    irregularity: str
    level: str
    label: str
    component: int


def number_name(stream: str, component: int) -> NumberName:
    """The name of a number of the stream "irregularity/level/label"."""
    irregularity, level, label = stream.split("/", 2)
    return NumberName(irregularity, level, label, component)


@dataclass(frozen=True, eq=False)
class DrawnNumbers:
    """The standard normals (d, B) [1] of B devices, with their names (d,)."""

    names: tuple[NumberName, ...]
    values: FloatArray


@dataclass
class RecordedNumbers:
    """Numbers of another source, remembered as they are read: stream -> rows (size, B), as standard normals."""

    numbers: Numbers
    rows: dict[str, FloatArray] = field(default_factory=dict)
    lengths: dict[str, tuple[float, ...]] = field(default_factory=dict)

    def normal(self, stream: str, keys: IntArray, size: int) -> FloatArray:
        """As :meth:`populations.numbers.Numbers.normal`."""
        found = self.numbers.normal(stream, keys, size)
        if size > len(self.rows.get(stream, ())):
            self.rows[stream] = found
        return found

    def uniform(self, stream: str, keys: IntArray) -> FloatArray:
        """As :meth:`populations.numbers.Numbers.uniform`."""
        found = self.numbers.uniform(stream, keys)
        # 0 has no finite Phi^-1; the smallest number above it that a generator gives is 2^-53.
        self.rows[stream + UNIFORM] = ndtri(np.maximum(found, 2.0**-54))[None]
        return found

    def fixed(self, stream: str, size: int) -> FloatArray:
        """As :meth:`populations.numbers.Numbers.fixed`."""
        return self.numbers.fixed(stream, size)

    def field(self, stream: str, keys: IntArray, die: IntArray, wafer: Wafer, length_mm: float) -> FloatArray:
        """As :meth:`populations.numbers.Numbers.field`."""
        found = self.numbers.field(stream, keys, die, wafer, length_mm)
        known = self.lengths.get(stream, ())
        if length_mm not in known:
            self.lengths[stream] = (*known, length_mm)
            self.rows[stream] = np.concatenate([self.rows[stream], found[None]]) if known else found[None]
        return found

    def drawn(self, count: int) -> DrawnNumbers:
        """What was read so far, for ``count`` devices, in the order of the first reading."""
        names = tuple(number_name(stream, k) for stream, rows in self.rows.items() for k in range(len(rows)))
        return DrawnNumbers(names, np.concatenate([np.zeros((0, count)), *self.rows.values()]))
