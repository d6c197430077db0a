"""Rules by estimate applied: does an estimate with its standard uncertainty prove that a limit is met, or that it is not?

The rules and their sources: ``reports.rules``.  Shapes: B devices, E ends of a limit.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from pipeline.arrays import BoolArray, FloatArray

from .limits import Limit
from .rules import Rule


@dataclass(frozen=True, eq=False)
class Zones:
    """(B,) whether a rule proves that a quantity conforms, and that it does not; neither where the estimate is unknown."""

    conforms: BoolArray
    violates: BoolArray


def zones(rule: Rule, limit: Limit, estimate: FloatArray, u: FloatArray) -> Zones:
    """What a rule by estimate says of one quantity.

    Parameters
    ----------
    rule : "simple" or "guard_band".
    limit : its limit.
    estimate, u : (B,) estimate and standard uncertainty [unit of the quantity]; u of 0 is an exact value.
    """
    inside = -np.stack(limit.beyond(estimate))
    known = np.isfinite(estimate) & ~np.isnan(u)
    nearest = inside.min(axis=0)
    if rule.consumer_risk is None:
        width = (rule.k or 0.0) * u
        conforming, violating = nearest >= width, nearest <= -width
        # Without a guard band a value at the limit conforms, and there is nothing between the two zones.
        return Zones(known & conforming, known & violating & ~conforming)
    p = probability_inside(inside, u)
    return Zones(known & (1.0 - p <= rule.consumer_risk), known & (p <= rule.consumer_risk))


def probability_inside(inside: FloatArray, u: FloatArray) -> FloatArray:
    """P(conform) (B,) = 1 - sum over the ends of Phi(-d/u) of a normal distribution (JCGM 106, 7.4); u = 0: whether it conforms.

    Parameters
    ----------
    inside : (E, B) distances d from each end, positive inside; u : (B,) standard uncertainty, same unit.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        tails = np.where(u > 0.0, ndtr(-inside / u), (inside < 0.0).astype(np.float64))
    return np.asarray(np.clip(1.0 - tails.sum(axis=0), 0.0, 1.0))


@dataclass(frozen=True, eq=False)
class RuleVerdicts:
    """(B,) whether devices pass and fail; ``outside`` quantity -> (B,) number of u by which its estimate is outside, else 0."""

    passes: BoolArray
    fails: BoolArray
    outside: dict[str, FloatArray]


def by_estimates(
    rule: Rule, limits: tuple[Limit, ...], estimates: Mapping[str, FloatArray], u: Mapping[str, FloatArray]
) -> RuleVerdicts:
    """The verdicts of a rule by estimate over all limits: pass where all conform, fail where one is proven not to.

    Parameters
    ----------
    limits : all limits.
    estimates, u : quantity -> (B,) estimate and standard uncertainty; nan where unknown: such a device cannot pass.
    """
    found = {one.quantity: zones(rule, one, estimates[one.quantity], u[one.quantity]) for one in limits}
    outside = {}
    for one in limits:
        beyond = np.max(np.stack(one.beyond(estimates[one.quantity])), axis=0)
        with np.errstate(divide="ignore", invalid="ignore"):
            far = np.where(u[one.quantity] > 0.0, beyond / u[one.quantity], np.inf)
        outside[one.quantity] = np.where(np.isfinite(estimates[one.quantity]) & (beyond > 0.0), far, 0.0)
    return RuleVerdicts(
        np.logical_and.reduce([zone.conforms for zone in found.values()]),
        np.logical_or.reduce([zone.violates for zone in found.values()]),
        outside,
    )
