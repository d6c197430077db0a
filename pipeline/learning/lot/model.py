"""A linear model of a lot: means and patterns that are the same for all, and random parts at each level.

    y_i = sum_p X_ip b_p + sum_c sqrt(v_c) sum_m Z_icm u_cm(unit of i) + e_i,       u ~ N(0, 1),   e_i ~ N(0, M_i)

A random part has one free number, v_c: its variance over that of its own columns, so that v = 1 is the size for which the
columns were made.  Parts with the same level and proportional columns are one part (``merged``): no data can tell them apart.

Shapes: n devices, q quantities, m normals per unit of a level.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from ...arrays import BoolArray, FloatArray

#: "place" is a place on all wafers; only probes have it.
LotLevel = Literal["device", "wafer", "lot", "tester", "all", "place"]
#: 1 - cosine of two covariance contributions below which no lot of a few thousand devices tells them apart.
PROPORTIONAL = 1e-4
#: Share of the whole spread of a quantity, below which a part counts in it by less than its own size.
SMALL = 1e-3


@dataclass(frozen=True, eq=False)
class RandomPart:
    """Normals of one level, with a common variance.

    Parameters
    ----------
    name : of the part.
    level : the unit that shares a normal; "all" is one unit.
    columns : (n, q, m) change of each quantity per normal; of a field m = 1 and the normal is a Gaussian process on a wafer.
    members : names of the parts that this one stands for, with the share of each in the variance at v = 1.
    field_mm : correlation length [mm] of exp(-d / length) on a wafer, for a field.
    start : variance factor at which a fit starts.
    """

    name: str
    level: LotLevel
    columns: FloatArray
    members: tuple[tuple[str, float], ...] = ()
    field_mm: float | None = None
    start: float = 1.0

    @property
    def shares(self) -> tuple[tuple[str, float], ...]:
        """``members``, or the part itself."""
        return self.members or ((self.name, 1.0),)


@dataclass(frozen=True, eq=False)
class FixedPart:
    """Columns (n, q, p) with free coefficients, such as the means, or a pattern that is the same on every wafer.

    ``size`` is the coefficient for which the columns were made; a free mean has none.  ``members`` are the patterns that it
    stands for, where no lot tells them apart.
    """

    name: str
    columns: FloatArray
    size: float | None = None
    members: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class LotModel:
    """Means and patterns, random parts, and ``offset`` (n, q): what the population predicts without them."""

    fixed: tuple[FixedPart, ...]
    random: tuple[RandomPart, ...]
    offset: FloatArray

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the random parts."""
        return tuple(part.name for part in self.random)

    def subset(self, chosen: BoolArray) -> LotModel:
        """The model of the devices where ``chosen`` (n,)."""
        return LotModel(
            tuple(replace(part, columns=part.columns[chosen]) for part in self.fixed),
            tuple(replace(part, columns=part.columns[chosen]) for part in self.random),
            self.offset[chosen],
        )

    def with_part(self, part: RandomPart | FixedPart) -> LotModel:
        """The model with one more part."""
        if isinstance(part, FixedPart):
            return replace(self, fixed=(*self.fixed, part))
        return replace(self, random=(*self.random, part))


def means(n: int, q: int) -> FixedPart:
    """A free mean of each quantity: columns (n, q, q)."""
    return FixedPart("mean", np.broadcast_to(np.eye(q), (n, q, q)).copy())


def contribution(part: RandomPart) -> FloatArray:
    """(n, q, q) variance of each device at v = 1."""
    return np.asarray(part.columns @ part.columns.transpose(0, 2, 1))


def merged(parts: Sequence[RandomPart]) -> tuple[RandomPart, ...]:
    """Parts with the same level (and field length) and proportional covariance as one, whose variance at v = 1 is their sum.

    Two parts whose columns span the same directions between all devices have proportional covariance; columns are compared by
    their Gram matrix over a sample of devices.
    """
    found: list[RandomPart] = []
    unit = unit_of(parts)
    for part in parts:
        if not np.any(part.columns):
            continue
        for k, other in enumerate(found):
            if (part.level, part.field_mm) == (other.level, other.field_mm) and _proportional(part, other, unit):
                found[k] = _sum(other, part)
                break
        else:
            found.append(part)
    return tuple(found)


def unit_of(parts: Sequence[RandomPart]) -> FloatArray | float:
    """(q,) sd of each quantity by all parts together, at v = 1; 1 where there are none."""
    if not parts:
        return 1.0
    sd = np.sqrt(sum(np.mean(np.sum(part.columns**2, axis=2), axis=0) for part in parts))
    return np.where(sd > 0.0, sd, 1.0)


def _proportional(a: RandomPart, b: RandomPart, unit: FloatArray | float) -> bool:
    step = max(1, len(a.columns) // 24)
    # Quantities have different units: each counts by what the two parts do to it.
    scale = np.sqrt(np.mean(a.columns**2, axis=(0, 2)) + np.mean(b.columns**2, axis=(0, 2)))
    scale = np.maximum(scale, SMALL * unit)[:, None]
    first, second = ((p.columns[::step] / scale).reshape(-1, p.columns.shape[-1]) for p in (a, b))
    one, two = first @ first.T, second @ second.T
    cosine = np.vdot(one, two) / np.sqrt(np.vdot(one, one) * np.vdot(two, two))
    return bool(1.0 - cosine < PROPORTIONAL)


def _sum(a: RandomPart, b: RandomPart) -> RandomPart:
    each = np.sum(a.columns**2, axis=(0, 2)), np.sum(b.columns**2, axis=(0, 2))
    most = int(np.argmax(each[0] / np.maximum(each[0] + each[1], 1e-300) * (each[0] > 0.0)))
    va, vb = float(each[0][most]), float(each[1][most])
    weight = va / (va + vb)
    members = (
        *((name, share * weight) for name, share in a.shares),
        *((name, share * (1.0 - weight)) for name, share in b.shares),
    )
    return replace(a, columns=a.columns * np.sqrt(1.0 + vb / va), members=members)
