"""Yield and its uncertainty when errors that all devices share are known to a standard deviation only.

Each of K values e_k of the common errors gives every device a verdict, P(conform | e_k) against the rule, hence x_k passed of n.
The sampling interval of the yield is then that of the mixture over k:

    low   1/K sum_k F(low;  x_k, n - x_k + 1) = a        F Beta cdf, a the tail probability (Clopper-Pearson at equal x_k)
    high  1/K sum_k F(high; x_k + 1, n - x_k) = 1 - a

and it contains the interval that the verdicts themselves give.  A wrong clock or phase moves all devices at once, so the
interval does not shrink to a point as n grows.  With groups as draws, x_k and n are the effective numbers of Korn and Graubard.

Shapes: K common errors, B devices.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pyarrow as pa
from scipy import special

from pipeline.arrays import BoolArray, FloatArray
from pipeline.store.column import number_values, text_codes

from .clusters import Clustering, effective_number
from .coded import IntArray, coded, numbered
from .devices import ColumnSource, Devices
from .rules import Rule
from .yields import LEVEL, GroupYield, Interval, Measurement, Yield, groups_of, poisson_binomial


@dataclass(frozen=True, eq=False)
class GivenCommon:
    """P(conform) (K, B) of each device at each value of the common errors, nan where unknown, and the rule."""

    p_pass: FloatArray
    rule: Rule

    @property
    def passed(self) -> BoolArray:
        """(K, B) whether the rule passes the device; a rule by estimate, where its equivalent probability is reached."""
        return np.asarray(self.p_pass >= self.rule.equivalent[0])

    @property
    def possible(self) -> BoolArray:
        """(K, B) whether the rule does not fail the device: passed or undecided."""
        return self.passed | ~np.asarray(self.p_pass <= self.rule.equivalent[1])

    def of(self, members: IntArray) -> GivenCommon:
        """The devices with the numbers ``members`` alone."""
        return GivenCommon(self.p_pass[:, members], self.rule)


def given_common(devices: Devices, posterior: ColumnSource | None, rule: Rule) -> GivenCommon | None:
    """P(conform) at each common error from the posterior table; ``None`` where the run declares no common errors."""
    if posterior is None or "p_pass_given_common" not in posterior.column_names:
        return None
    known = posterior.select(["p_pass_given_common"]).to_batches()
    if all(batch.column(0).null_count == batch.num_rows for batch in known):
        return None
    last = max(int(_numbers(batch, 0).max(initial=0)) for batch in posterior.select(["draw"]).to_batches())
    place = {name: i for i, name in enumerate(devices.text("device_id"))}
    p_pass = np.full((last + 1, len(devices)), np.nan)
    for batch in posterior.select(["device_id", "draw", "p_pass_given_common"]).to_batches():
        words, codes = text_codes(pa.chunked_array([batch.column(0)]))
        places = np.array([place[name] for name in words], dtype=np.int64)
        p_pass[_numbers(batch, 1).astype(np.int64), places[codes]] = _numbers(batch, 2)
    return GivenCommon(p_pass, rule)


def _numbers(batch: pa.RecordBatch, column: int) -> FloatArray:
    return number_values(pa.chunked_array([batch.column(column)]))


def _root(function: Callable[[float], float], low: float, high: float) -> float:
    from scipy.optimize import brentq  # loading it takes a quarter of a second

    return float(brentq(function, low, high, xtol=1e-14))


def mixed_clopper_pearson(count: FloatArray, n: FloatArray, method: str, level: float = LEVEL) -> Interval:
    """The interval of the mixture of Clopper-Pearson distributions of counts (K,) of n (K,), which may be effective numbers."""
    tail = 0.5 * (1.0 - level)

    def low(p: float) -> float:
        return (
            float(np.mean(np.where(count > 0, special.betainc(np.maximum(count, 1e-9), n - count + 1.0, p), 1.0)))
            - tail
        )

    def high(p: float) -> float:
        inside = special.betainc(count + 1.0, np.maximum(n - count, 1e-9), p)
        return float(np.mean(np.where(count < n, inside, 0.0))) - (1.0 - tail)

    # A share of at least the tail without any pass (or without any loss) takes the interval to its end.
    return Interval(
        0.0 if low(0.0) >= 0.0 else _root(low, 0.0, 1.0),
        1.0 if high(1.0 - 1e-15) <= 0.0 else _root(high, 0.0, 1.0),
        method,
        level,
    )


def mixed_wilson(count: FloatArray, n: float, level: float = LEVEL) -> Interval:
    """The p at which the score test, averaged over counts (K,) of n, does not reject: Wilson's interval at equal counts."""
    tail = 0.5 * (1.0 - level)

    def above(p: float) -> float:
        score = (count / n - p) / np.sqrt(p * (1.0 - p) / n)
        return float(np.mean(special.ndtr(score)))

    edge = 1e-12
    low = 0.0 if above(edge) <= 1.0 - tail else _root(lambda p: above(p) - (1.0 - tail), edge, 1.0 - edge)
    high = 1.0 if above(1.0 - edge) >= tail else _root(lambda p: above(p) - tail, edge, 1.0 - edge)
    return Interval(float(low), float(high), "Wilson, common errors included", level)


def _hull(one: Interval, other: Interval) -> Interval:
    """The least interval that contains both, by the method of ``other``."""
    return replace(other, low=min(one.low, other.low), high=max(one.high, other.high))


def with_common(found: Yield, given: GivenCommon | None) -> Yield:
    """``found`` with intervals that contain the common errors; unchanged without them."""
    if given is None or not found.devices:
        return found
    n = np.full(given.p_pass.shape[0], float(found.devices))
    passed, possible = (part.sum(axis=1).astype(np.float64) for part in (given.passed, given.possible))
    mixed = mixed_clopper_pearson(passed, n, "Clopper-Pearson, common errors included")
    most = mixed_clopper_pearson(possible, n, f"{mixed.method}, undecided either way")
    return replace(
        found,
        clopper_pearson=_hull(found.clopper_pearson, mixed),
        wilson=_hull(found.wilson, mixed_wilson(passed, float(found.devices))),
        envelope=_hull(found.envelope, replace(most, low=mixed.low)),
    )


def clustering_with_common(found: Clustering, groups: Sequence[str], given: GivenCommon | None) -> Clustering:
    """``found`` with an interval that contains the common errors; ``groups``: B names."""
    if given is None or found.interval is None:
        return found
    names, index = numbered(coded(groups).codes)
    parts = [effective_number(passed.astype(np.float64), index, names.size) for passed in given.passed]
    share, n = np.array([part.share for part in parts]), np.array([part.effective for part in parts])
    mixed = mixed_clopper_pearson(share * n, n, f"{found.interval.method}, common errors included")
    return replace(found, interval=_hull(found.interval, mixed))


def groups_with_common(
    found: Sequence[GroupYield], lots: Sequence[str], wafers: Sequence[str] | None, given: GivenCommon | None
) -> tuple[GroupYield, ...]:
    """The yield of each lot or wafer with intervals that contain the common errors; names as for ``by_group``."""
    if given is None:
        return tuple(found)
    names, index = groups_of(lots, wafers)
    # The devices of a group are those between two bounds, once they are in the order of their groups.
    order = np.argsort(index, kind="stable")
    bounds = np.searchsorted(index[order], np.arange(len(names) + 1))
    members = {name: order[low:high] for name, low, high in zip(names, bounds[:-1], bounds[1:], strict=True)}
    return tuple(replace(row, result=with_common(row.result, given.of(members[row.lot, row.wafer]))) for row in found)


def measurement_given_common(given: GivenCommon, level: float = LEVEL) -> Measurement:
    """The number of conforming devices: a mixture over the common errors of Poisson-binomial distributions."""
    known = np.all(np.isfinite(given.p_pass), axis=0)
    p = given.p_pass[:, known]
    pmf = np.zeros(p.shape[1] + 1)
    for row in p:
        certain = int(np.sum(row == 1.0))
        part = poisson_binomial(row[(row > 0.0) & (row < 1.0)])
        pmf[certain : certain + part.size] += part / p.shape[0]
    counts = np.arange(pmf.size)
    mean = float(np.sum(p)) / p.shape[0]
    spread = float(np.sum(pmf * (counts - mean) ** 2))
    tail = 0.5 * (1.0 - level)
    low, high = (min(int(np.searchsorted(np.cumsum(pmf), at)), pmf.size - 1) for at in (tail, 1.0 - tail))
    return Measurement(p.shape[1], given.p_pass.shape[1] - p.shape[1], mean, float(np.sqrt(spread)), low, high)
