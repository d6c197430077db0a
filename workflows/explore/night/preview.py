"""The verdicts by moved limits within a frame of the screen: counts of stored draws instead of a new judgement of all of them.

``reports.what_if.draws`` gives every stored draw of a device the weight p/s where it meets the run's limits and (1 - p)/(1 - s)
where it does not, so the same sum is known from two counts:

    P(conform) = (p/s a + (1 - p)/(1 - s) b) / n      a, b: draws that meet the moved limits, and do or do not meet the run's

While one limit moves, which draws meet the others is fixed and is kept as one byte per draw; what is left is one comparison for
each draw of the devices whose draws lie on both sides of a limit.  Draws are kept as float32 deviations from the estimate of
the device: a rounding of 1e-7 sd.  A device some of whose draws have no value of a limited quantity may be shown as failed where
it is undecided.  So a preview is shown as one, until the judgement of ``workflows.what_if`` replaces it.

Shapes: B devices, n draws each, absent ones at the end of a row.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
from numba import njit

from pipeline.arrays import FloatArray, IntArray
from pipeline.axial import PERIOD_DEG, difference
from pipeline.quantities import AXES
from reports.coded import CodedText
from reports.limits import Limit, Limits
from reports.what_if.draws import DrawBatch, contains

Bytes = npt.NDArray[np.uint8]
#: Codes of the verdicts, in this order.
VERDICTS = ("undecided", "pass", "fail")


@dataclass(frozen=True, eq=False)
class DrawDeviations:
    """Draws of one quantity.

    Parameters
    ----------
    centre : (B,) estimates.
    draws : (B, n) deviations from them; nan where there is no draw.
    size : (B,) number of draws.
    """

    centre: FloatArray
    draws: npt.NDArray[np.float32]
    size: IntArray

    @cached_property
    def reach(self) -> FloatArray:
        """(B, 2) smallest and largest deviation; -inf and inf where a draw is absent, inf and -inf where all are."""
        out = np.empty((self.draws.shape[0], 2))
        _reach(self.draws, out)
        return out

    def meet(self, limit: Limit) -> Bytes:
        """(B, n) 1 where a draw meets the limit."""
        out = np.empty(self.draws.shape, dtype=np.uint8)
        _meet(self.draws, self.centre, *_ends(limit), out)
        return out


def deviations(
    centres: Mapping[str, FloatArray], batches: Iterable[DrawBatch], most: int = 0
) -> dict[str, DrawDeviations]:
    """The draws of the quantities in ``centres`` (their estimates (B,), nan where unknown) from ``batches``.

    ``batches`` hold each device at most once; ``most`` : expected largest number of draws of a device.
    """
    middles = {name: np.where(np.isnan(centre), 0.0, centre) for name, centre in centres.items()}
    rows = next(iter(middles.values())).size
    draws = {name: np.full((rows, most), np.nan, dtype=np.float32) for name in middles}
    size = np.zeros(rows, dtype=np.int64)
    for batch in batches:
        for name, middle in middles.items():
            values, own = batch.values[name], middle[batch.rows, None]
            if values.shape[1] > draws[name].shape[1]:
                draws[name] = np.pad(
                    draws[name], ((0, 0), (0, values.shape[1] - draws[name].shape[1])), constant_values=np.nan
                )
            away = difference(values, own) if name in AXES else values - own
            draws[name][batch.rows, : values.shape[1]] = away
            size[batch.rows] = values.shape[1]
    return {name: DrawDeviations(middle, draws[name], size) for name, middle in middles.items()}


@dataclass(frozen=True, eq=False)
class Weights:
    """What does not depend on the moved limits.

    Parameters
    ----------
    old : limits of the run.
    p_run : (B,) P(conform to ``old``) of the run; nan where it is unknown.
    met : (B, n) 1 where a draw meets ``old``.
    inside, outside : (B,) weight over n of a draw that does and of one that does not; nan without draws.
    """

    old: Limits
    p_run: FloatArray
    met: Bytes
    inside: FloatArray
    outside: FloatArray


def weights(old: Limits, p_run: FloatArray, draws: dict[str, DrawDeviations]) -> Weights:
    """The weights of the draws of all quantities that ``old`` limits."""
    met = np.bitwise_and.reduce([draws[one.quantity].meet(one) for one in old.limits])
    n = draws[old.quantities[0]].size
    with np.errstate(divide="ignore", invalid="ignore"):
        share = met.sum(axis=1, dtype=np.int64) / n
        weighted = np.isfinite(p_run) & (share > 0.0) & (share < 1.0)
        p, s = np.where(weighted, p_run, 0.5), np.where(weighted, share, 0.5)
        n = np.where(n > 0, n, np.nan)
        return Weights(old, p_run, met, p / s / n, (1.0 - p) / (1.0 - s) / n)


@dataclass(frozen=True, eq=False)
class Kept:
    """What stays while a limit moves.

    Parameters
    ----------
    others : the limits that do not move.
    met : for each draw (B, n): bit 0, it meets them; bit 1, it meets those of the run.
    counts : (B, 2) draws that meet ``others``: those that meet the limits of the run, and those that do not.
    """

    others: tuple[Limit, ...]
    met: Bytes
    counts: IntArray


def kept(found: Weights, limits: Limits, moving: str, draws: dict[str, DrawDeviations], before: Kept | None) -> Kept:
    """What stays while the limit of ``moving`` moves; ``before`` if nothing else changed."""
    others = tuple(one for one in limits.limits if one.quantity != moving)
    if before is not None and before.others == others:
        return before
    own = np.ones_like(found.met)
    for one in others:
        own &= draws[one.quantity].meet(one)
    own |= np.left_shift(found.met, 1, dtype=np.uint8)
    counts = np.zeros((own.shape[0], 2), dtype=np.int64)
    _totals(own, counts)
    return Kept(others, own, counts)


def p_conform(
    found: Weights, limits: Limits, moving: DrawDeviations | None, limit: Limit | None, own: Kept
) -> FloatArray:
    """(B,) P(conform to ``limits``), nan without draws.

    Parameters
    ----------
    limits : all limits, with ``limit`` where it has been moved to.
    moving, limit : the draws and the limit that moves; ``None``: it was removed.
    own : what stays.
    """
    counts = own.counts
    if moving is not None and limit is not None:
        counts = np.zeros_like(own.counts)
        _count(own.met, own.counts, moving.draws, moving.centre, moving.reach, *_ends(limit), counts)
    inside, outside = counts.T
    p = found.inside * inside + found.outside * outside
    known = np.isfinite(found.p_run) & np.isfinite(p)
    if contains(limits, found.old):
        p = np.where(known, np.maximum(p, found.p_run), p)
    if contains(found.old, limits):
        p = np.where(known, np.minimum(p, found.p_run), p)
    return p


def verdict_codes(p: FloatArray, limits: Limits, status: CodedText) -> IntArray:
    """(B,) codes of :data:`VERDICTS` by the rule "probability", from P(conform) (B,) and the statuses."""
    judged, rule = status.equals("ok"), limits.rule
    return np.where(judged & (p >= rule.pass_at), 1, np.where(judged & (p <= rule.fail_at), 2, 0)).astype(np.int64)


def _ends(limit: Limit) -> tuple[float, float, float]:
    """Low, high and the period of the quantity, 0 for none."""
    return limit.low, limit.high, PERIOD_DEG if limit.axis else 0.0


@njit(cache=True, nogil=True)
def _inside(x: float, low: float, high: float, period: float) -> bool:
    if period > 0.0:
        # nan stays nan and is outside, as below.
        away = x - low - period * np.floor((x - low) / period)
        return away <= high - low
    return low <= x <= high


@njit(cache=True, nogil=True)
def _meet(draws, centre, low, high, period, out):  # type: ignore[no-untyped-def]
    for b in range(draws.shape[0]):
        for i in range(draws.shape[1]):
            out[b, i] = 1 if _inside(centre[b] + draws[b, i], low, high, period) else 0


@njit(cache=True, nogil=True)
def _reach(draws, out):  # type: ignore[no-untyped-def]
    for b in range(draws.shape[0]):
        low, high, absent = np.inf, -np.inf, 0
        for i in range(draws.shape[1]):
            x = draws[b, i]
            if np.isnan(x):
                absent += 1
            else:
                low, high = min(low, x), max(high, x)
        partly = 0 < absent < draws.shape[1]
        out[b, 0], out[b, 1] = (-np.inf, np.inf) if partly else (low, high)


@njit(cache=True, nogil=True)
def _totals(met, counts):  # type: ignore[no-untyped-def]
    for b in range(met.shape[0]):
        for i in range(met.shape[1]):
            if met[b, i] & 1:
                counts[b, 1 - (met[b, i] >> 1)] += 1


@njit(cache=True, nogil=True)
def _side(centre, reach, low, high, period):  # type: ignore[no-untyped-def]
    """1: all draws meet the limit; -1: none does; 0: each has to be compared."""
    if reach[0] > reach[1]:
        return -1
    if period == 0.0:
        if centre + reach[0] >= low and centre + reach[1] <= high:
            return 1
        return -1 if centre + reach[1] < low or centre + reach[0] > high else 0
    if not reach[1] - reach[0] < period:
        return 0
    # Rounding may put a draw at an end of the arc on its other side.
    room = 1e-9 * period
    first = centre + reach[0] - low
    first -= period * np.floor(first / period)
    last = first + reach[1] - reach[0]
    if last <= high - low - room:
        return 1
    return -1 if first > high - low + room and last < period - room else 0


@njit(cache=True, nogil=True)
def _count(met, totals, draws, centre, reach, low, high, period, counts):  # type: ignore[no-untyped-def]
    for b in range(draws.shape[0]):
        side = _side(centre[b], reach[b], low, high, period)
        if side == 1:
            counts[b] = totals[b]
        elif side == 0:
            for i in range(draws.shape[1]):
                if met[b, i] & 1 and _inside(centre[b] + draws[b, i], low, high, period):
                    counts[b, 1 - (met[b, i] >> 1)] += 1
