"""Irregularities that need no physics: patterns over wafers, time and testers.  One file each, discovered automatically.

A generic irregularity makes parts for any table.  Its random parts act on one quantity each, in units of ``scale``, the spread
of that quantity; a fixed part acts on all of them, one free coefficient each.  ``probe`` marks shapes that show a misfit but
are never named, because they say nothing about its cause.

Shapes: n devices, q quantities.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np

from ...arrays import FloatArray
from ...errors import ConfigError
from .measured import MeasuredLot
from .model import FixedPart, LotLevel, RandomPart

Needs = Literal["lots", "wafers", "places", "time", "testers", "quantities"]


@dataclass(frozen=True)
class GenericIrregularity:
    """Name, meaning in one line, what the lot must have, and the parts for a lot and the scale (q,) of its quantities."""

    name: str
    meaning: str
    needs: tuple[Needs, ...]
    parts: Callable[[MeasuredLot, FloatArray], tuple[RandomPart | FixedPart, ...]]
    probe: bool = False

    def applies(self, lot: MeasuredLot) -> bool:
        """Whether the lot has what it needs."""
        has: dict[Needs, bool] = {
            "lots": int(lot.codes("lot").max()) > 0,
            "wafers": int(lot.codes("wafer").max()) > 0,
            "places": lot.placed,
            "time": bool(np.all(np.isfinite(lot.time)) and np.ptp(lot.time) > 0.0),
            "testers": "tester" in lot.labels and int(lot.codes("tester").max()) > 0,
            "quantities": len(lot.quantities) > 1,
        }
        return all(has[need] for need in self.needs)


def by_quantity(
    name: str, level: LotLevel, lot: MeasuredLot, scale: FloatArray, shapes: FloatArray
) -> tuple[RandomPart, ...]:
    """A random part for each quantity: the columns (n, m) ``shapes`` times its scale; named "name(quantity)"."""
    found = []
    for k, quantity in enumerate(lot.quantities):
        columns = np.zeros((len(shapes), len(scale), shapes.shape[1]))
        columns[:, k] = scale[k] * shapes
        found.append(RandomPart(f"{name}({quantity})", level, columns, start=0.04))
    return tuple(found)


def same_everywhere(name: str, lot: MeasuredLot, scale: FloatArray, shapes: FloatArray) -> tuple[FixedPart, ...]:
    """A fixed part for each quantity: the columns (n, m) ``shapes`` times its scale; named "name(quantity)"."""
    found = []
    for k, quantity in enumerate(lot.quantities):
        columns = np.zeros((len(shapes), len(scale), shapes.shape[1]))
        columns[:, k] = scale[k] * shapes
        found.append(FixedPart(f"{name}({quantity})", columns))
    return tuple(found)


@lru_cache(maxsize=1)
def generic_irregularities() -> Mapping[str, GenericIrregularity]:
    """All shipped ones by name.

    Raises
    ------
    ConfigError : a file does not define one.
    """
    from . import irregularities

    found: dict[str, GenericIrregularity] = {}
    for info in pkgutil.iter_modules(irregularities.__path__):
        one = getattr(importlib.import_module(f"{irregularities.__name__}.{info.name}"), "GENERIC", None)
        if not isinstance(one, GenericIrregularity):
            raise ConfigError(
                f"pipeline/learning/lot/irregularities/{info.name}.py defines no GENERIC",
                value=one,
                allowed="a GenericIrregularity",
                next_step="see the other files of the folder",
            )
        found[one.name] = one
    return dict(sorted(found.items()))
