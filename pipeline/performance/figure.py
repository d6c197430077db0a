"""Performance figures: result quantities that follow from the identified device and its declared operation, one file each.

Each file in ``pipeline/performance/figures`` defines FIGURE = Figure(...); no list of figures is kept anywhere else.  A figure is
a pure function of a batch: ``value(OpenLoop) -> (...)``, applied to every posterior draw, so that its sd and interval follow from
those of the device, and to the truth of a virtual device.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np

from ..arrays import FloatArray
from . import figures as library
from .open_loop import OpenLoop
from .operating_point import OperatingPoint

#: Where a key that a figure needs is declared.
_TABLES = {"angular_gain": "[device]", "bias_v": "[instrument]"}


def _place(key: str) -> str:
    return f"{_TABLES.get(key, '[operation]')} {key}"


def by_table(places: Iterable[str]) -> str:
    """Keys with their tables, each table once: "[operation] gap_um, mass_mg and [device] angular_gain"."""
    tables: dict[str, dict[str, None]] = {}
    for place in places:
        table, _, key = place.partition(" ")
        tables.setdefault(table, {})[key] = None
    return " and ".join(f"{table} {', '.join(keys)}" for table, keys in tables.items())


@dataclass(frozen=True, repr=False)
class Figure:
    """One performance figure.

    Parameters
    ----------
    name, unit, meaning : as of a quantity; the name is also that of the file and of the columns.
    label : name in sentences.
    formula, source : the equation, and where it comes from.
    needs : keys of ``OperatingPoint`` and ``DeclaredOperation`` without which the figure is unknown.
    value : the figure (...) [unit] of a gyro; called only where all ``needs`` are declared.
    """

    name: str
    unit: str
    meaning: str
    label: str
    formula: str
    source: str
    needs: tuple[str, ...]
    value: Callable[[OpenLoop], FloatArray]

    @property
    def condition(self) -> str:
        """What must be declared, as an addition to the meaning."""
        needed = by_table(map(_place, self.needs))
        # The noise of the pick-offs is the only input that records can show.
        return f"; null without {needed}".replace("pickoff_noise_v", "pickoff_noise_v or silence") if self.needs else ""

    def known(self, point: OperatingPoint) -> bool:
        """Whether all that it needs is declared."""
        return all(point.declared(key) for key in self.needs)

    def missing(self, point: OperatingPoint) -> tuple[str, ...]:
        """The keys that would have to be declared, with their tables: "[operation] gap_um"."""
        return tuple(_place(key) for key in self.needs if not point.declared(key))


@cache
def find_figures() -> dict[str, Figure]:
    """All figures by name, in the order of their names."""
    modules = sorted(module.name for module in pkgutil.iter_modules(library.__path__))
    found = (importlib.import_module(f"{library.__name__}.{name}").FIGURE for name in modules)
    return {figure.name: figure for figure in found}


def figure_values(q: Mapping[str, FloatArray], point: OperatingPoint) -> dict[str, FloatArray]:
    """Every figure (...) by name of quantities ``q`` (...); nan where it is unknown."""
    gyro = OpenLoop(q, point)
    unknown = np.full(np.shape(q["f1_hz"]), np.nan)
    with np.errstate(invalid="ignore", divide="ignore"):
        return {
            name: np.asarray(figure.value(gyro)) if figure.known(point) else unknown
            for name, figure in find_figures().items()
        }


def unknown_figures(point: OperatingPoint) -> dict[str, tuple[str, ...]]:
    """The figures that are unknown, and what would have to be declared for each."""
    return {name: missing for name, figure in find_figures().items() if (missing := figure.missing(point))}
