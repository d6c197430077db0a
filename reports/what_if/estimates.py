"""Devices judged again by their estimates and standard uncertainties, without draws: rules by estimate.

Shapes: B devices, E ends of limits, G positions, L limits.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pipeline.arrays import BoolArray, FloatArray

from ..acceptance import probability_inside, zones
from ..limits import Limit, Limits
from ..rules import Rule
from .draws import EndGrid, pairs_of


@dataclass(frozen=True, eq=False)
class Estimates:
    """Quantity -> (B,) estimate and its standard uncertainty; nan where unknown."""

    value: Mapping[str, FloatArray]
    u: Mapping[str, FloatArray]


def conforms_each(rule: Rule, limits: Sequence[Limit], found: Estimates) -> BoolArray:
    """(L, B) whether the rule proves that each limit is met."""
    return np.array([zones(rule, one, found.value[one.quantity], found.u[one.quantity]).conforms for one in limits])


def curves(limits: Limits, found: Estimates, grids: Sequence[EndGrid]) -> BoolArray:
    """(E, G, B) whether the device passes with an end moved to each position and all else as it is."""
    each = conforms_each(limits.rule, limits.limits, found)
    names = limits.quantities
    out = np.zeros((len(grids), grids[0].coordinates.size, each.shape[1]), dtype=np.bool_)
    for e, grid in enumerate(grids):
        limit = grid.end.limit
        good = np.flatnonzero(np.delete(each, names.index(limit.quantity), axis=0).all(axis=0))
        value, u = found.value[limit.quantity][good], found.u[limit.quantity][good]
        for g, position in enumerate(grid.end.position(grid.coordinates)):
            moved = replace(limit, high=float(position)) if grid.end.high else replace(limit, low=float(position))
            if moved.low <= moved.high:
                out[e, g, good] = zones(limits.rule, moved, value, u).conforms
    return out


def without(limits: Limits, found: Estimates) -> BoolArray:
    """(1 + L + pairs, B) whether the device passes without no limit, without each, and without each pair."""
    broken = ~conforms_each(limits.rule, limits.limits, found)
    number = broken.sum(axis=0)
    rows = [number == 0, *(number == one for one in broken)]
    rows += [number == broken[i].astype(np.int64) + broken[j] for i, j in pairs_of(len(broken))]
    return np.array(rows)


def p_inside(limits: Limits, found: Estimates) -> FloatArray:
    """(L, B) probability that each limit is met, of normal distributions (JCGM 106, 7.4); nan where unknown."""
    rows = []
    for limit in limits.limits:
        value, u = found.value[limit.quantity], found.u[limit.quantity]
        p = probability_inside(-np.stack(limit.beyond(np.where(np.isnan(value), 0.0, value))), u)
        rows.append(np.where(np.isnan(value) | np.isnan(u), np.nan, p))
    return np.array(rows)
