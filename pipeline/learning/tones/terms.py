"""Candidate terms of frequency-domain records: the absent effects that change a steady response, and unsettled detectors.

Ranges are relative to the data: a parameter may have any size, its step is the one that changes the response by about 1e-3, and
an additional mode is sought at the frequencies and widths that the records resolve.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

import numpy as np

from ...arrays import ComplexArray
from ...device.model import Model
from ...errors import GyroscreenError
from ...experiment.tones import ToneCampaign

#: Stages that a steady response can show, and those of a linear one.
STAGES = frozenset({"drive", "mechanics", "force", "sense", "readout"})
_LINEAR = frozenset({"mechanics", "readout"})
#: Relative change of the response that gives the size of a parameter, and how near a size must come (factor) in how many tries.
_CHANGE, _NEAR, _TRIES = 1e-3, 10.0, 12
#: Odd part of a response, relative to the even one, below which a sign does not show.
_EVEN = 1e-3
#: Frequencies and widths of an additional mode: rows of a width, and points of the grid at most.
_WIDTHS, _POINTS = (3.0,), 48


def term_names(model: Model, swept: bool) -> tuple[str, ...]:
    """Absent effects that act on a steady response; a frequency response has no level, so it shows linear effects only.

    A force law with coordinates of its own is no candidate: the steady motion of a hidden mode starts anew for every set of
    parameters (87 s instead of 2 s for a measured wire), and that of a memory is not computed.
    """
    stages = STAGES if swept else _LINEAR
    found = (name for name in model.candidates(swept) if set(model.library[name].stages) & stages)
    return tuple(name for name in found if not model.library[name].has_coordinates)


class Nearby(Protocol):
    """Records as a function of parameters."""

    @property
    def full(self) -> Model:
        """Plant and every effect."""
        ...

    def nearby(self, values: Mapping[str, float]) -> Callable[[Mapping[str, float]], Sequence[Any]]:
        """Values close to ``values`` -> arrays of volts, one for each record."""
        ...


def sizes_of(model: Nearby, names: Sequence[str], values: Mapping[str, float]) -> dict[str, float]:
    """Full parameter name -> size that changes the response at ``values`` by about 1e-3.

    Parameters that do not change it are left out.
    """
    near = model.nearby(values)
    plain = near(values)
    norm = float(np.sqrt(sum(np.vdot(y, y).real for y in plain)))
    shape, found = model.full.built.shape, {}
    for name in names:
        effect = model.full.library[name]
        members = effect.members(shape)
        grid = {effect.full_name(m): m.grid[len(m.grid) // 2] for m in members if m.grid}
        for member in members:
            if member.grid:
                continue
            full = effect.full_name(member)
            size = _size(near, {**values, **grid}, full, member.null, member.scale, plain, norm)
            if size is not None:
                found[full] = size
    return found


def _size(
    near: Callable[[Mapping[str, float]], Sequence[ComplexArray]],
    values: Mapping[str, float],
    name: str,
    null: float,
    size: float,
    plain: Sequence[ComplexArray],
    norm: float,
) -> float | None:
    low = 0.0
    for _ in range(_TRIES):
        try:
            moved = near({**values, name: null + size})
        except GyroscreenError:
            size *= 1e-3
            continue
        change = float(np.sqrt(sum(np.sum(np.abs(a - b) ** 2) for a, b in zip(moved, plain)))) / norm
        if not np.isfinite(change):
            size *= 1e-3
        elif change < 1e-13:
            low = size
            size *= 1e4
        elif _CHANGE / _NEAR < change < _CHANGE * _NEAR:
            return size
        else:
            # The root, because a change may grow as the square of the size.
            size *= float(np.clip(np.sqrt(_CHANGE / change), 1e-6, 1e6))
    return size if low == 0.0 else None


def even_parameters(model: Nearby, sizes: Mapping[str, float], values: Mapping[str, float]) -> frozenset[str]:
    """Parameters with a size whose sign does not change the response at ``values``, such as a quadratic stiffness."""
    near, found = model.nearby(values), set()
    plain = near(values)
    for name, size in sizes.items():
        if name not in model.full.by_name or model.full.by_name[name].low >= 0.0:
            continue
        try:
            above, below = (near({**values, name: side * size}) for side in (1.0, -1.0))
        except GyroscreenError:
            continue
        changes = [np.concatenate([np.ravel(a - b) for a, b in zip(each, plain)]) for each in (above, below)]
        if np.linalg.norm(changes[0] - changes[1]) < _EVEN * np.linalg.norm(changes[0] + changes[1]):
            found.add(name)
    return frozenset(found)


def mode_grid(campaign: ToneCampaign) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Frequencies [Hz] within the rows, and damping ratios that a few rows resolve."""
    f = np.unique(np.concatenate([record.frequency_hz for record in campaign.records]))
    step = float(np.median(np.diff(f))) if f.size > 1 else 1e-3 * float(f[0])
    step = max(step, float(np.ptp(f)) / _POINTS / 4.0)
    points = np.linspace(f[0], f[-1], min(_POINTS, f.size))
    zetas = [min(width * step / (2.0 * float(np.median(f))), 0.3) for width in _WIDTHS]
    return tuple(points.tolist()), tuple(sorted({*zetas, min(8.0 * zetas[-1], 0.4)}))
