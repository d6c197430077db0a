"""Two nights: how much yield and quantities differ, with intervals and tests that hold for all of them together.

Quantities, with the groups (lots) of each night as draws:  d = mean_after - mean_before,  Welch's t with their standard errors
The yield:  low = d - sqrt((p2 - l2)^2 + (u1 - p1)^2),  high = d + sqrt((u2 - p2)^2 + (p1 - l1)^2)

with the interval l to u of each night.  Nights that hold the same devices are compared device by device: the mean of the
differences, groups as draws.  p-values of the K tests are raised by Holm's method, so that the probability of any false "differs"
is at most 5 %.

Source: Welch 1947, Biometrika 34:28; Newcombe 1998, Stat. Med. 17:873, method 10, with cluster intervals as in Zou and Donner
2008, Stat. Med. 27:1693; Holm 1979, Scand. J. Stat. 6:65.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import brentq
from scipy.special import stdtr

from ..yields import LEVEL
from .charted import YIELD
from .night import Grouping, Mean, Night, grouped_mean

#: Probability of any false "differs" among all tests of a comparison.
FAMILY = 0.05
#: log10 of the largest p-value of the yield below 1; an interval at level 0 has no width and no effective number.
_CLOSEST = -1e-3


@dataclass(frozen=True)
class Difference:
    """``name`` before and after, the difference with its interval at ``LEVEL``, and p alone and within the family."""

    name: str
    before: float
    after: float
    difference: float
    low: float
    high: float
    p: float
    p_family: float = 1.0

    @property
    def differs(self) -> bool:
        """Whether the family-wise test finds a difference."""
        return self.p_family <= FAMILY


@dataclass(frozen=True)
class Comparison:
    """The differences between two nights; ``paired`` if both hold the same devices, ``by`` the groups that are draws."""

    before: str
    after: str
    paired: bool
    by: str
    groups: tuple[int, int]
    differences: tuple[Difference, ...]


def compared(before: Night, after: Night, names: Sequence[str], paired: bool) -> Comparison:
    """Yield and the quantities ``names`` of two nights; ``paired``: they hold the same devices, in any order."""
    if paired:
        rows = _paired(before, after, names)
    else:
        before, after = _same_groups(before, after)
        rows = [
            _yield_difference(before, after),
            *(_welch(name, before.mean(name), after.mean(name)) for name in names),
        ]
    groups = (before.grouping.groups, after.grouping.groups)
    return Comparison(before.run_id, after.run_id, paired, after.grouping.by, groups, holm(rows))


def holm(rows: Sequence[Difference]) -> tuple[Difference, ...]:
    """The rows with family-wise p-values: max over the smaller ones of (K - rank) p, at most 1; unknown ones do not count."""
    order = sorted((row.p, k) for k, row in enumerate(rows) if math.isfinite(row.p))
    family: dict[int, float] = {}
    worst = 0.0
    for rank, (p, k) in enumerate(order):
        worst = max(worst, min(1.0, (len(order) - rank) * p))
        family[k] = worst
    return tuple(replace(row, p_family=family.get(k, float("nan"))) for k, row in enumerate(rows))


def _same_groups(before: Night, after: Night) -> tuple[Night, Night]:
    """Both nights with groups of the same kind: single devices unless both have the same."""
    if before.grouping.by == after.grouping.by:
        return before, after
    return tuple(  # type: ignore[return-value]
        replace(night, grouping=Grouping("device", np.arange(night.devices, dtype=np.int64)))
        for night in (before, after)
    )


def _welch(name: str, before: Mean, after: Mean) -> Difference:
    parts = (before.se**2, after.se**2)
    variance = sum(parts)
    if not math.isfinite(variance):
        return _unknown(name, before.value, after.value)
    freedom = variance**2 / sum(one**2 / mean.df for one, mean in zip(parts, (before, after))) if variance else 1.0
    return _student(
        name, before.value, after.value, Mean(after.value - before.value, math.sqrt(variance), freedom, "", 0)
    )


def _student(name: str, before: float, after: float, found: Mean) -> Difference:
    """The difference ``found``, tested by Student's t."""
    if not math.isfinite(found.se):
        return _unknown(name, before, after)
    low, high = found.interval()
    t = abs(found.value) / found.se if found.se else 0.0 if found.value == 0.0 else math.inf
    return Difference(name, before, after, found.value, low, high, 2.0 * float(stdtr(found.df, -t)))


def _unknown(name: str, before: float, after: float) -> Difference:
    return Difference(name, before, after, after - before, float("nan"), float("nan"), float("nan"))


def _yield_difference(before: Night, after: Night) -> Difference:
    found = after.share - before.share
    if not math.isfinite(found):
        return _unknown(YIELD, before.share, after.share)

    def ends(level: float) -> tuple[float, float]:
        one, two = before.yield_interval(level), after.yield_interval(level)
        p1, p2 = before.share, after.share
        return (
            found - math.hypot(p2 - two.low, one.high - p1),
            found + math.hypot(two.high - p2, p1 - one.low),
        )

    low, high = ends(LEVEL)

    def nearest(logit: float) -> float:
        """The end next to zero, positive while the interval at 1 - 10^logit excludes zero."""
        lower, upper = ends(1.0 - 10.0**logit)
        return lower if found > 0.0 else -upper

    # The p-value is 1 - level of the interval that just touches zero; it is not resolved below 1e-12.
    if found == 0.0 or nearest(_CLOSEST) <= 0.0:
        p = 1.0
    else:
        p = 1e-12 if nearest(-12.0) > 0.0 else 10.0 ** float(brentq(nearest, -12.0, _CLOSEST, xtol=1e-6))
    return Difference(YIELD, before.share, after.share, found, low, high, p)


def _paired(before: Night, after: Night, names: Sequence[str]) -> list[Difference]:
    """Differences of each device; its group is the one that the later night states."""
    place = {name: k for k, name in enumerate(before.device_id)}
    rows = np.array([place[name] for name in after.device_id], dtype=np.int64)
    moved = after.passed.astype(np.float64) - before.passed[rows]
    found = [_student(YIELD, before.share, after.share, grouped_mean(moved, after.grouping))]
    for name in names:
        one, two = before.values[name][rows], after.values[name]
        both = np.isfinite(one) & np.isfinite(two)
        mean = grouped_mean(np.where(both, two - one, np.nan), after.grouping)
        before_mean, after_mean = (float(values[both].mean()) if both.any() else float("nan") for values in (one, two))
        found.append(_student(name, before_mean, after_mean, mean))
    return found
