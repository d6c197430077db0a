"""Stored posterior draws judged again by other limits, in batches of devices.

A run judges all draws and stores some of them.  Its own P(conform) = P is therefore known better than the share s of the stored
draws that meet the old limits.  The draws are weighted so that the old limits give what the run found (poststratification):

    w = P / s  where a draw meets the old limits,   (1 - P) / (1 - s)  where it does not
    P' = 1/n sum of w over the draws that meet the new limits
    sd(P')^2 = P^2 a (1 - a) / (n s) + (1 - P)^2 b (1 - b) / (n (1 - s))

with a and b the shares of the draws of each kind that meet the new limits.  Limits that contain the old ones give P' >= P, limits
that lie within them P' <= P; the same limits give P itself.

Shapes: B devices of the run, b of a batch, n draws each, L limits, E ends of limits, G positions.
Source: Owen, Monte Carlo theory, methods and examples (2013), 8.4 (poststratification).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.arrays import BoolArray, FloatArray
from pipeline.axial import wrap

from ..coded import IntArray
from ..limits import Limit, Limits

#: Sums of weights reach a threshold that their exact values reach.
_ROUNDING = 1e-12


@dataclass(frozen=True, eq=False)
class DrawBatch:
    """Stored draws of some devices: numbers of their rows (b,) in the devices table, and quantity -> (b, n) draws."""

    rows: IntArray
    values: Mapping[str, FloatArray]


@dataclass(frozen=True)
class LimitEnd:
    """One finite end of a limit: ``high`` or not, and its coordinate, which grows outwards from within the limit."""

    limit: Limit
    high: bool

    @property
    def at(self) -> float:
        """Coordinate of the end."""
        if self.limit.axis:
            return 0.5 * (self.limit.high - self.limit.low)
        return self.limit.high if self.high else -self.limit.low

    @property
    def value(self) -> float:
        """The end in the unit of the quantity."""
        return self.limit.high if self.high else self.limit.low

    def coordinate(self, values: FloatArray) -> FloatArray:
        """Coordinate of values (...), which conform to this end up to ``at``; for an axis from the middle of the arc."""
        if self.limit.axis:
            away = wrap(values - 0.5 * (self.limit.low + self.limit.high))
            return away if self.high else -away
        return values if self.high else -values

    def position(self, coordinate: FloatArray) -> FloatArray:
        """Coordinates (...) in the unit of the quantity."""
        signed = coordinate if self.high else -coordinate
        return signed + (0.5 * (self.limit.low + self.limit.high) if self.limit.axis else 0.0)


def ends_of(*limits: Limit) -> tuple[LimitEnd, ...]:
    """The finite ends of limits, in their order."""
    ends = (LimitEnd(limit, high) for limit in limits for high in (False, True))
    return tuple(end for end in ends if np.isfinite(end.value))


@dataclass(frozen=True, eq=False)
class EndGrid:
    """An end of a limit and the coordinates (G,) to which it is moved, in even steps."""

    end: LimitEnd
    coordinates: FloatArray

    def first_conforming(self, values: FloatArray) -> IntArray:
        """Number of the first position at which values (...) conform to the end; G where they never do, or are nan."""
        c, count = self.coordinates, self.coordinates.size
        step = (c[-1] - c[0]) / (count - 1)
        place = np.ceil((self.end.coordinate(values) - c[0]) / step - 1e-9)
        return np.asarray(np.clip(np.where(np.isnan(place), count, place), 0, count).astype(np.int64))


def contains(outer: Limits, inner: Limits) -> bool:
    """Whether every device that conforms to ``inner`` conforms to ``outer``."""
    known = {limit.quantity: limit for limit in inner.limits}
    return all(
        limit.quantity in known and limit.low <= known[limit.quantity].low and known[limit.quantity].high <= limit.high
        for limit in outer.limits
    )


@dataclass(frozen=True, eq=False)
class Reweighted:
    """Draws of a batch with their weights.

    Parameters
    ----------
    weight : (b, n) w.
    met : quantity -> (b, n) whether the draw meets its new limit.
    surely, maybe : (b,) bounds of P(conform to the new limits); they differ where draws are nan.
    sd : (b,) Monte Carlo sd of P.
    stored_old : (b,) share of the stored draws that meets the old limits.
    own : (L, b) share of the draws that possibly meets each new limit.
    """

    weight: FloatArray
    met: dict[str, BoolArray]
    surely: FloatArray
    maybe: FloatArray
    sd: FloatArray
    stored_old: FloatArray
    own: FloatArray

    @property
    def p_pass(self) -> FloatArray:
        """(b,) P(conform to the new limits); nan where it is unknown."""
        return np.where(self.surely == self.maybe, self.surely, np.nan)


@dataclass(frozen=True, eq=False)
class Passes:
    """Which devices of a batch pass when limits change further.

    Parameters
    ----------
    curves : (E, G, b) with an end moved to each position and all else as it is.
    without : (1 + L + pairs, b) without no limit, without each, and without each pair.
    """

    curves: BoolArray
    without: BoolArray


def pairs_of(count: int) -> tuple[tuple[int, int], ...]:
    """The pairs i < j of ``count`` limits."""
    return tuple((i, j) for i in range(count) for j in range(i + 1, count))


def reweighted(batch: DrawBatch, p_run: FloatArray, old: Limits, new: Limits) -> Reweighted:
    """The draws of a batch, judged by ``new``.

    Parameters
    ----------
    batch : draws of every quantity that ``old`` or ``new`` limits.
    p_run : (b,) P(conform to the old limits) of the run; nan where it is unknown: then all draws have the same weight.
    old, new : the limits of the run and the new ones.
    """
    met_old = np.logical_and.reduce([limit.admits(batch.values[limit.quantity]) for limit in old.limits])
    met = {limit.quantity: limit.admits(batch.values[limit.quantity]) for limit in new.limits}
    unknown = {name: np.isnan(batch.values[name]) for name in met}
    all_met = np.logical_and.reduce(list(met.values()))
    n = all_met.shape[1]
    share, plain, both = met_old.mean(axis=1), all_met.mean(axis=1), np.mean(all_met & met_old, axis=1)
    weighted = np.isfinite(p_run) & (share > 0.0) & (share < 1.0)
    p, s = np.where(weighted, p_run, 0.5), np.where(weighted, share, 0.5)
    w = np.where(met_old, (p / s)[:, None], ((1.0 - p) / (1.0 - s))[:, None])
    a, b = both / s, (plain - both) / (1.0 - s)
    spread = p**2 * a * (1.0 - a) / (n * s) + (1.0 - p) ** 2 * b * (1.0 - b) / (n * (1.0 - s))
    spread = np.where(weighted, spread, plain * (1.0 - plain) / n)
    surely = maybe = _nested(np.mean(w * all_met, axis=1), p_run, old, new)
    if any(one.any() for one in unknown.values()):
        possible = [good | unknown[name] for name, good in met.items()]
        maybe = _nested(np.mean(w * np.logical_and.reduce(possible), axis=1), p_run, old, new)
    own = np.array([np.mean(good | unknown[name], axis=1) for name, good in met.items()])
    return Reweighted(w, met, surely, maybe, np.sqrt(np.maximum(spread, 0.0)), share, own)


def reweighted_share(
    n: int, met_old: IntArray, met_new: IntArray, met_both: IntArray, p_run: FloatArray, old: Limits, new: Limits
) -> FloatArray:
    """P(conform to ``new``) (...) as :func:`reweighted` gives it, from counts (...) of ``n`` draws without nan.

    Parameters
    ----------
    met_old, met_new, met_both : draws that meet the old limits, the new ones, and both.
    p_run, old, new : as of :func:`reweighted`.
    """
    share, plain, both = met_old / n, met_new / n, met_both / n
    weighted = np.isfinite(p_run) & (share > 0.0) & (share < 1.0)
    p, s = np.where(weighted, p_run, 0.5), np.where(weighted, share, 0.5)
    return _nested(np.where(weighted, p / s * both + (1.0 - p) / (1.0 - s) * (plain - both), plain), p_run, old, new)


def passes(batch: DrawBatch, found: Reweighted, grids: Sequence[EndGrid], pass_at: float) -> Passes:
    """Which devices reach P(conform) >= ``pass_at`` when the limits change further."""
    reach = pass_at - _ROUNDING
    return Passes(
        np.array([_curve(batch, found.weight, found.met, grid) >= reach for grid in grids]).transpose(0, 2, 1),
        _without(found.weight, list(found.met.values())) >= reach,
    )


def _nested(p: FloatArray, p_run: FloatArray, old: Limits, new: Limits) -> FloatArray:
    """P' (b,) bounded by P of the run where one set of limits contains the other."""
    known = np.isfinite(p_run)
    if contains(new, old):
        p = np.where(known, np.maximum(p, p_run), p)
    if contains(old, new):
        p = np.where(known, np.minimum(p, p_run), p)
    return p


def _curve(batch: DrawBatch, w: FloatArray, met: Mapping[str, BoolArray], grid: EndGrid) -> FloatArray:
    """P(conform) (b, G) with one end of one limit moved over its grid."""
    devices, n = w.shape
    count = grid.coordinates.size
    limit, values = grid.end.limit, batch.values[grid.end.limit.quantity]
    others = [good for name, good in met.items() if name != limit.quantity]
    other_end = [end for end in ends_of(limit) if end.high != grid.end.high]
    others += [end.coordinate(values) <= end.at for end in other_end]
    good = np.logical_and.reduce(others) if others else np.ones(w.shape, dtype=np.bool_)
    alive = np.flatnonzero(good.any(axis=1))
    place = grid.first_conforming(values[alive]) + (count + 1) * np.arange(alive.size)[:, None]
    sums = np.bincount(place.ravel(), (w[alive] * good[alive]).ravel(), alive.size * (count + 1))
    p = np.zeros((devices, count))
    p[alive] = sums.reshape(alive.size, count + 1)[:, :count].cumsum(axis=1) / n
    return p


def _without(w: FloatArray, met: list[BoolArray]) -> FloatArray:
    """P(conform) (1 + L + pairs, b) without no limit, without each, and without each pair: by the limits that each draw fails."""
    devices, n = w.shape
    mask = np.zeros(w.shape, dtype=np.int64)
    for i, good in enumerate(met):
        mask |= (~good).astype(np.int64) << i
    single = [1 << i for i in range(len(met))]
    pairs = pairs_of(len(met))
    sets = np.array([0, *single, *(single[i] | single[j] for i, j in pairs)], dtype=np.int64)
    order = np.argsort(sets)
    found = np.clip(np.searchsorted(sets[order], mask), 0, sets.size - 1)
    known = sets[order][found] == mask
    place = np.where(known, order[found], sets.size) + (sets.size + 1) * np.arange(devices)[:, None]
    sums = np.bincount(place.ravel(), w.ravel(), devices * (sets.size + 1)).reshape(devices, sets.size + 1).T / n
    none, alone, both = sums[0], sums[1 : 1 + len(met)], sums[1 + len(met) : -1]
    without_pair = [none + alone[i] + alone[j] + both[k] for k, (i, j) in enumerate(pairs)]
    return np.stack([none, *(none + one for one in alone), *without_pair])
