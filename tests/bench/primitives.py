"""Primitives: what the limit of a part is made of, and the reference loop.

The limit of a part is the time of its arithmetic at the speed that this machine shows in the same run,

    limit = sum_i count_i unit_i,     unit_i = least time of primitive i / its count

    normal      a standard normal of numpy's default generator            60,000 of them are the reference loop
    flop        a product or sum of a product of two 256 x 256 matrices   2 n^3 of them
    transform   N log2 N of a real transform of N = 30,000 samples
    comparison  n log2 n of a sort of n = 3072 numbers, in rows

A primitive with a count may be a bound (flop) or the measured least time of what the part cannot do without (normal, transform).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.fft import rfft

REFERENCE = "normal"
_RANDOM = np.random.default_rng(1)
_MATRIX = _RANDOM.standard_normal((256, 256))
_RECORD = _RANDOM.standard_normal((2, 30_000))
_ROWS = _RANDOM.standard_normal((32, 3072))


@dataclass(frozen=True)
class Primitive:
    """``count`` units of work."""

    count: float
    work: Callable[[], Any]


def transforms(samples: int, channels: int) -> float:
    """Units of ``channels`` real transforms of ``samples`` samples."""
    return channels * samples * math.log2(samples)


def comparisons(numbers: int, rows: int) -> float:
    """Units of sorting ``rows`` rows of ``numbers`` numbers."""
    return rows * numbers * math.log2(numbers)


def reference() -> object:
    """The reference loop: 60,000 normals, the noise of one record."""
    return np.random.default_rng(2).standard_normal(60_000)


PRIMITIVES = {
    REFERENCE: Primitive(60_000.0, reference),
    "flop": Primitive(2.0 * 256**3, lambda: _MATRIX @ _MATRIX),
    "transform": Primitive(transforms(30_000, 2), lambda: rfft(_RECORD, axis=-1)),
    "comparison": Primitive(comparisons(3072, 32), lambda: np.sort(_ROWS, axis=1)),
}
