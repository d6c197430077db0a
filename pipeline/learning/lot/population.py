"""What the loop knows of a population at the devices of a lot, as arrays, and the population of a table that has none.

Shapes: n devices, q quantities.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...arrays import BoolArray, FloatArray
from .generic import generic_irregularities
from .measured import MeasuredLot
from .model import SMALL, FixedPart, LotModel, RandomPart, means

Part = RandomPart | FixedPart


@dataclass(frozen=True, eq=False)
class DeviceMixture:
    """A change that a share of the devices has, such as a leaking lid: N(mean, columns columns') (n, q), (n, q, m)."""

    name: str
    mean: FloatArray
    columns: FloatArray
    share: float

    def subset(self, chosen: BoolArray) -> DeviceMixture:
        """For the devices where ``chosen`` (n,)."""
        return replace(self, mean=self.mean[chosen], columns=self.columns[chosen])


@dataclass(frozen=True, eq=False)
class LotPopulation:
    """A population at the devices of a lot.

    Parameters
    ----------
    name : of the population.
    model : parts of the population, whose v = 1 and coefficients 0 are the values of its file.
    candidates : parts of irregularities that the file lacks or holds at null.
    absent_mixtures : changes of a share of the devices that the file lacks.
    mixtures : changes that a share of the devices has.
    curvature : (q, q) covariance of what the first order leaves out.
    """

    name: str
    model: LotModel
    candidates: tuple[Part, ...] = ()
    mixtures: tuple[DeviceMixture, ...] = ()
    curvature: FloatArray | None = None
    absent_mixtures: tuple[DeviceMixture, ...] = ()


def spread_of(lot: MeasuredLot) -> FloatArray:
    """(q,) robust sd of each quantity over all devices; 1 where it is zero."""
    middle = np.nanmedian(lot.values, axis=0)
    sd = 1.4826 * np.nanmedian(np.abs(lot.values - middle), axis=0)
    sd = np.where(sd > 0.0, sd, np.nanstd(lot.values, axis=0))
    return np.where(sd > 0.0, sd, 1.0)


def nested_population(lot: MeasuredLot) -> LotPopulation:
    """For a table without a population file: means, and spreads of lots, wafers and devices of each quantity."""
    n, q = lot.values.shape
    scale = spread_of(lot)
    levels = [level for level in ("lot", "wafer") if int(lot.codes(level).max()) > 0]
    # One wafer in each lot: the two levels are one.
    if len(levels) == 2 and lot.codes("wafer").max() == lot.codes("lot").max():
        levels.remove("wafer")
    parts = []
    for level in (*levels, "device"):
        for k, quantity in enumerate(lot.quantities):
            columns = np.zeros((n, q, 1))
            columns[:, k, 0] = scale[k]
            parts.append(RandomPart(f"{level}_spread({quantity})", level, columns, start=0.3))  # type: ignore[arg-type]
    return LotPopulation("nested", LotModel((means(n, q),), tuple(parts), np.zeros((n, q))))


def generic_parts(lot: MeasuredLot, scale: FloatArray, probes: bool) -> tuple[Part, ...]:
    """Parts of all generic irregularities that apply to the lot; only the probes, or only the others."""
    return tuple(
        part
        for one in generic_irregularities().values()
        if one.applies(lot) and one.probe == probes
        for part in one.parts(lot, scale)
    )


def distinct(
    fixed: Sequence[FixedPart], others: Sequence[FixedPart], unit: FloatArray | float, cosine: float = 0.999
) -> tuple[FixedPart, ...]:
    """Those of ``others`` that are not combinations of ``fixed`` and of each other, to within ``cosine``.

    Two patterns with the same shape become one, their sum.  A part must also move some quantity by ``SMALL`` of its spread
    ``unit`` (q,).
    """
    kept: list[FixedPart] = []
    weight = (1.0 / np.broadcast_to(np.asarray(unit), fixed[0].columns.shape[1:2]))[:, None]
    for part in others:
        twin = next((k for k, one in enumerate(kept) if _alike(one, part, weight, cosine)), None)
        if twin is not None:
            other = kept[twin]
            members = (*(other.members or (other.name,)), part.name)
            kept[twin] = replace(other, columns=other.columns + part.columns, members=members)
            continue
        known = np.concatenate(
            [(one.columns * weight).reshape(-1, one.columns.shape[2]) for one in (*fixed, *kept)], axis=1
        )
        flat = (part.columns * weight).reshape(-1, part.columns.shape[2])
        left = float(np.sum((flat - known @ np.linalg.lstsq(known, flat, rcond=None)[0]) ** 2))
        moving = float(np.sum(_moving(part, weight) ** 2))
        if left > (1.0 - cosine**2) * moving and left > SMALL**2 * len(part.columns):
            kept.append(part)
    return tuple(kept)


def _moving(part: FixedPart, weight: FloatArray) -> FloatArray:
    scaled = part.columns * weight
    return np.asarray(scaled - scaled.mean(axis=0))


def _alike(a: FixedPart, b: FixedPart, weight: FloatArray, cosine: float) -> bool:
    if a.columns.shape != b.columns.shape:
        return False
    one, two = _moving(a, weight), _moving(b, weight)
    size = float(np.sqrt(np.sum(one**2) * np.sum(two**2)))
    return size > 0.0 and abs(float(np.vdot(one, two))) > cosine * size
