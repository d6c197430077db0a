"""How many draws of each device meet the old and the new limits at each value of the common errors, in one compiled loop.

A common error multiplies what was measured, so a quantity at node k is q_k = a_k u + b_k v of at most two quantities u, v without
errors (``pipeline.inference.systematic.common_factors``); u and v are computed once, not at each node.

Shapes: K nodes, b devices, n draws, U quantities without errors, Q quantities with limits that the errors move.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit

from pipeline.arrays import BoolArray, FloatArray, IntArray
from reports.limits import Limit, Limits

#: Quantity -> its terms: a quantity without errors, and its factor (K,) at each node.
Terms = Mapping[str, Sequence[tuple[str, FloatArray]]]
_OPEN = Limit("", -np.inf, np.inf)


@dataclass(frozen=True, eq=False)
class Counts:
    """Draws (K, b) that meet the old limits, the new ones, and both."""

    old: IntArray
    new: IntArray
    both: IntArray


def counts(values: Mapping[str, FloatArray], terms: Terms, old: Limits, new: Limits) -> Counts:
    """The draws that meet the limits at each node.

    Parameters
    ----------
    values : quantity -> (b, n) draws without common errors, none of them nan; every limited one and those of its terms.
    terms : of the limited quantities that the errors move; the others stay as they are.
    old, new : limits.
    """
    before, after = ({one.quantity: one for one in limits.limits} for limits in (old, new))
    shape = next(iter(values.values())).shape
    fixed = [
        np.logical_and.reduce([np.ones(shape, dtype=np.bool_), *_still(values, limits, terms)])
        for limits in (before, after)
    ]
    moved = [name for name in dict.fromkeys((*before, *after)) if name in terms]
    nodes = len(next(iter(terms.values()))[0][1])
    used = list(dict.fromkeys(base for name in moved for base, _ in terms[name]))
    bases = np.stack([values[base] for base in used]) if used else np.zeros((0, *shape))
    place, factor = np.full((len(moved), 2), -1), np.zeros((len(moved), 2, nodes))
    for q, name in enumerate(moved):
        for j, (base, at_nodes) in enumerate(terms[name]):
            place[q, j], factor[q, j] = used.index(base), at_nodes
    ends = np.array(
        [[end for side in (before, after) for end in _ends(side.get(name, _OPEN))] for name in moved]
    ).reshape(len(moved), 4)
    found = _counts(np.ascontiguousarray(bases), place, factor, ends, fixed[0], fixed[1])
    return Counts(*found)


def _still(values: Mapping[str, FloatArray], limits: Mapping[str, Limit], terms: Terms) -> list[BoolArray]:
    """(b, n) whether each limit of a quantity that the errors do not move is met."""
    return [limit.admits(values[name]) for name, limit in limits.items() if name not in terms]


def _ends(limit: Limit) -> tuple[float, float]:
    return limit.low, limit.high


@njit(cache=True, nogil=True)
def _counts(
    bases: FloatArray, place: IntArray, factor: FloatArray, ends: FloatArray, still_old: BoolArray, still_new: BoolArray
) -> IntArray:
    """(3, K, b) counts; bases (U, b, n), place (Q, 2) in them or -1, factor (Q, 2, K), ends (Q, 4) old and new, still (b, n)."""
    devices, n = still_old.shape
    nodes = factor.shape[2]
    out = np.zeros((3, nodes, devices), dtype=np.int64)
    meets_old, meets_new = np.empty(n, dtype=np.uint8), np.empty(n, dtype=np.uint8)
    for d in range(devices):
        for k in range(nodes):
            for i in range(n):
                meets_old[i] = still_old[d, i]
                meets_new[i] = still_new[d, i]
            for q in range(place.shape[0]):
                u, a = bases[place[q, 0], d], factor[q, 0, k]
                old_low, old_high, new_low, new_high = ends[q]
                if place[q, 1] < 0:
                    for i in range(n):
                        value = a * u[i]
                        meets_old[i] &= (value >= old_low) & (value <= old_high)
                        meets_new[i] &= (value >= new_low) & (value <= new_high)
                else:
                    v, b = bases[place[q, 1], d], factor[q, 1, k]
                    for i in range(n):
                        value = a * u[i] + b * v[i]
                        meets_old[i] &= (value >= old_low) & (value <= old_high)
                        meets_new[i] &= (value >= new_low) & (value <= new_high)
            old, new, both = 0, 0, 0
            for i in range(n):
                old += meets_old[i]
                new += meets_new[i]
                both += meets_old[i] & meets_new[i]
            out[0, k, d] = old
            out[1, k, d] = new
            out[2, k, d] = both
    return out
