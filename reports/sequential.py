"""The sequential decision: pass or fail while a record still grows, with a guarantee for every single device.

    guarantee   A device whose quantity lies more than 2 sd beyond a limit passes with probability at most 1 - pass_at.
                A device that meets every limit by more than 2 sd fails with probability at most fail_at.
                sd is that of the last analysis.  Probabilities are over the noise, for a fixed device, over all analyses
                together, whatever their number and whatever the population.  Where the estimates are calibrated, that is,
                scatter about the truth by their sd at each analysis.

At analysis k = 1, 2, ..  z = (limit - mean)/sd is positive inside the limit, and z_k its least value over all limits:

    pass   P(conform) >= pass_at   and   z_k >=  c_k(1 - pass_at)
    fail   P(conform) <= fail_at   and   z_k <= -c_k(fail_at / m)          m ends of limits

    c_k(a)    = Phi^-1(1 - a / (k (k + 1)))       more records may follow
    c_last(a) = Phi^-1(1 - a / k) - 2             the record has ended

For a device at a limit, z_k is wrong by more than c_k with probability a / (k (k + 1)).  These probabilities add up to
a (1 - 1/k) before analysis k, however the analyses depend on each other, and the last analysis has the rest, a / k, at 2 sd
from the limit.  A pass needs all limits, so one limit that is not met bounds its probability; a fail needs one of m ends.

P(conform) alone is a posterior probability: its errors average to the nominal rate over a population that is drawn from the
prior, but repeated analyses of one device near a limit find many occasions to err.

Shapes: n draws of one device.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from scipy.special import ndtri

from pipeline.arrays import FloatArray
from pipeline.axial import wrap
from pipeline.errors import UsageError

from .decision import Verdict, decide
from .limits import Limit, Limits

#: Distance from a limit in final sd beyond which the error rate is guaranteed: nearer devices may stay undecided.
INDIFFERENCE_SD = 2.0


def check_rule(limits: Limits) -> None:
    """Check that the limits can be judged while a record grows.

    Raises
    ------
    UsageError : the rule is not "probability": its thresholds are what the guarantee is stated for.
    """
    if limits.rule.by_estimate:
        raise UsageError(
            "a record that grows is judged by the rule 'probability' alone",
            value=limits.rule.name,
            allowed="[rule] with pass_at and fail_at, or none",
            next_step="state the rule 'probability', or identify the whole record without --stream",
        )


def boundary(alpha: float, analysis: int, last: bool = False) -> float:
    """c_k: the least distance from a limit, in sd, for a decision at ``analysis`` k = 1, 2, .. with error budget ``alpha``."""
    if last:
        return float(-ndtri(alpha / analysis)) - INDIFFERENCE_SD
    return float(-ndtri(alpha / (analysis * (analysis + 1.0))))


def margin(limits: Limits, draws: Mapping[str, FloatArray]) -> float:
    """Least distance of the mean from an end of a limit, in sd, positive inside; nan where no limited quantity is known."""
    found = [_margin(limit, np.asarray(draws[limit.quantity])) for limit in limits.limits]
    known = [one for one in found if not math.isnan(one)]
    return min(known, default=math.nan)


def _margin(limit: Limit, values: FloatArray) -> float:
    if np.any(np.isnan(values)):
        return math.nan
    low, high, mean = limit.low, limit.high, float(np.mean(values))
    if limit.axis:
        # Deviations from the middle of the arc; those of a posterior across its far side are taken about its own mean.
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
        mean = float(np.rad2deg(np.angle(np.mean(np.exp(2j * np.deg2rad(values - middle)))))) / 2.0
        values, low, high = wrap(values - middle - mean), -half, half
    sd = float(np.std(values))
    with np.errstate(divide="ignore", invalid="ignore"):
        return float(np.min(np.array([mean - low, high - mean]) / sd))


def ends(limits: Limits) -> int:
    """Number m of finite ends of limits; at least 1."""
    return max(1, sum(math.isfinite(end) for limit in limits.limits for end in (limit.low, limit.high)))


def decide_at(
    limits: Limits, draws: Mapping[str, FloatArray], status: str, analysis: int, last: bool = False
) -> tuple[float, Verdict]:
    """P(conform), nan where unknown, and the verdict of the sequential rule.

    Parameters
    ----------
    limits : limits and rule.
    draws : quantity -> (n,) posterior draws of the records so far, in the units of the results columns.
    status : of the estimate; other than "ok" is undecided.
    analysis : number of this analysis, from 1; every analysis counts, whatever its status.
    last : whether the record has ended.

    Raises
    ------
    UsageError : a limited quantity has no draws.
    """
    decision = decide(limits, {name: np.asarray(draws[name])[None] for name in limits.quantities}, [status])
    p_pass = float(decision.p_pass[0])
    return p_pass, checked(limits, decision.verdict[0], margin(limits, draws), analysis, last)


def checked(limits: Limits, by_posterior: Verdict, least: float, analysis: int, last: bool = False) -> Verdict:
    """The verdict ``by_posterior`` if ``least``, the :func:`margin`, is beyond its boundary; otherwise undecided."""
    rule = limits.rule
    if by_posterior == "pass" and least >= boundary(1.0 - rule.pass_at, analysis, last):
        return "pass"
    if by_posterior == "fail" and least <= -boundary(rule.fail_at / ends(limits), analysis, last):
        return "fail"
    return "undecided"
