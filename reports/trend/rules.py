"""Run rules of a control chart, with limits that give them a stated false-alarm rate together.

A rule "k of n" alarms at a point if that point and at least k - 1 of the n - 1 before it lie beyond the rule's limit z on the
same side.  These are the rules of Western Electric (1956): 1 of 1, 2 of 3, 4 of 5 and 8 of 8, with z = 3, 2, 1 and 0 in the
textbook.  There they alarm falsely at 1.65 % of the points of one chart.  Here the same rules have limits such that

    P(alarm at a point | in control) = rate,    each rule with the same share s of it:   p P(Bin(n - 1, p) >= k - 1) = s / 2

with p = P(N(0, 1) > z).  The overlap of the rules is counted exactly: the last five points are enumerated by the zones in which
they lie, and the older points of a longer rule, of which all must be beyond, enter as a power.

Source: Western Electric, Statistical Quality Control Handbook (1956); Montgomery, Introduction to Statistical Quality Control,
ch. 5 (rules); Champ and Woodall, Technometrics 29 (1987) 393 (combined rules have an exact false-alarm rate; an average run
length of 91.75 with the textbook limits, which a test reproduces).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.optimize import brentq
from scipy.special import bdtrc, ndtr, ndtri

from pipeline.arrays import BoolArray, FloatArray


@dataclass(frozen=True)
class RunRule:
    """``k`` of the last ``n`` points, the last among them, beyond ``limit`` [sd] on the same side."""

    k: int
    n: int
    limit: float

    @property
    def name(self) -> str:
        """ "2 of 3"."""
        return f"{self.k} of {self.n}"


#: The rules with the limits of the textbook.
WESTERN_ELECTRIC = (RunRule(1, 1, 3.0), RunRule(2, 3, 2.0), RunRule(4, 5, 1.0), RunRule(8, 8, 0.0))
#: Points that are enumerated one by one; a rule over more points must need all of them.
_ENUMERATED = 5


def alarms(points: FloatArray, rules: Sequence[RunRule]) -> BoolArray:
    """(..., R) whether each of the R rules alarms at the last of the ``points`` (..., T), oldest first; nan is never beyond."""
    found = []
    for rule in rules:
        window = points[..., -rule.n :]
        one_side = [
            beyond[..., -1] & (np.sum(beyond, axis=-1) >= rule.k)
            for beyond in (window > rule.limit, window < -rule.limit)
        ]
        found.append(one_side[0] | one_side[1])
    return np.stack(found, axis=-1)


def alarm_probability(rules: Sequence[RunRule]) -> float:
    """P(any rule alarms at a point) where the points are independent and N(0, 1)."""
    short = [rule for rule in rules if rule.n <= _ENUMERATED]
    long = [rule for rule in rules if rule.n > _ENUMERATED]
    edges = np.unique([side * rule.limit for rule in rules for side in (-1.0, 1.0)])
    cells = np.diff(ndtr(np.concatenate([[-np.inf], edges, [np.inf]])))
    # A value inside each cell stands for all values there.
    inside = np.concatenate([[edges[0] - 1.0], 0.5 * (edges[1:] + edges[:-1]), [edges[-1] + 1.0]])
    shape = (cells.size,) * _ENUMERATED
    place = np.stack(np.unravel_index(np.arange(np.prod(shape)), shape), axis=1)
    points, weight = inside[place], np.prod(cells[place], axis=1)
    sure = alarms(points, short).any(axis=1) if short else np.zeros(len(place), dtype=np.bool_)
    quiet = np.ones(len(place))
    for rule in long:
        older = rule.n - _ENUMERATED
        p = float(ndtr(-rule.limit))
        up, down = np.all(points > rule.limit, axis=1), np.all(points < -rule.limit, axis=1)
        both = max(0.0, 2.0 * p - 1.0)  # beyond a negative limit on both sides at once
        quiet *= 1.0 - (up * p**older + down * p**older - (up & down) * both**older)
    return float(np.sum(weight * np.where(sure, 1.0, 1.0 - quiet)))


@lru_cache(maxsize=256)
def calibrated(rate: float, points: int) -> tuple[RunRule, ...]:
    """The rules of Western Electric for a series of ``points`` points, with limits that alarm falsely at ``rate`` of the points.

    A rule that needs more points than there are is left out, and a window is no longer than the series.
    """
    shapes = [(rule.k, min(rule.n, points)) for rule in WESTERN_ELECTRIC if rule.k <= points]

    def rules(share: float) -> tuple[RunRule, ...]:
        return tuple(RunRule(k, n, _limit(k, n, share)) for k, n in shapes)

    if len(shapes) == 1:
        return rules(rate)
    share = brentq(lambda one: alarm_probability(rules(one)) - rate, rate / (2.0 * len(shapes)), rate, rtol=1e-10)
    return rules(float(share))


def _limit(k: int, n: int, share: float) -> float:
    """z [sd] with p P(Bin(n - 1, p) >= k - 1) = share / 2, p = P(N(0, 1) > z)."""

    def excess(z: float) -> float:
        p = float(ndtr(-z))
        others = 1.0 if k == 1 else float(bdtrc(k - 2, n - 1, p))
        return float(np.log(p * others) - np.log(0.5 * share))

    # P(Bin >= n - 1) with n - 1 = k - 1 trials is exact in logarithms, so the bracket may be wide.
    return float(-ndtri(0.5 * share)) if k == 1 else float(brentq(excess, -8.0, 8.0, xtol=1e-12))
