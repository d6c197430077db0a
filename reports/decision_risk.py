"""Consumer's and producer's risk of a decision rule: for each limited quantity alone, and in total.

    specific consumer's risk  1 - P(conform) of an accepted device              (JCGM 106:2012, 3.3.13, 9.3)
    global consumer's risk    R_C = P(accepted and not conforming)              (3.3.15, 9.5)
    global producer's risk    R_P = P(not accepted and conforming)              (3.3.16, 9.5)

as shares of all devices that were judged, three times:

    devices   R_C = 1/n sum over accepted (1 - p_i),  R_P = 1/n sum over not accepted p_i     by the posterior of each device
    normal    a normal process N(m, s) as prior, a normal measurement with the rms u, acceptance limits A, conformity C:
              R_C = P(Y in A) - P(Y in A, X in C),  R_P = P(X in C) - P(Y in A, X in C),   X ~ N(m, s),  Y = X + N(0, u)
    truth     counted, of virtual devices

m and s are those of ``reports.capability``, measurement variance removed.  Where the posteriors are calibrated and the process is
normal, the three agree within their intervals.  The interval of ``devices`` is Clopper-Pearson at the effective number of devices
(``reports.clusters``, wafers as draws).  The number of wrong decisions among these devices has a central 95 % interval, too
(Poisson-binomial), in which the count by the truth should lie.

An undecided device is not accepted.  A quantity alone is judged by its own estimate and uncertainty, as a normal distribution.

Shapes: B devices.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from scipy.special import ndtr, ndtri, owens_t

from pipeline.arrays import BoolArray, FloatArray

from .acceptance import probability_inside, zones
from .capability import Common, normal_process
from .clusters import effective_number
from .coded import CodedText, IntArray, numbered
from .devices import Devices
from .limits import Limit, Limits
from .rules import Rule
from .yields import Interval, clopper_pearson, measurement_uncertainty

_CERTAIN = 1e-9
#: Factors of guard bands of a curve of the risks.
K_CURVE: FloatArray = np.linspace(0.0, 4.0, 81)


@dataclass(frozen=True)
class RiskShare:
    """A risk as a share of all judged devices.

    Parameters
    ----------
    value, interval : by the devices' posteriors, with the 95 % interval for the process.
    expected, expected_low, expected_high : number of wrong decisions among these devices, and its central 95 %.
    normal : by the normal process; ``None`` where there is none.
    counted, counted_interval : wrong decisions by the truth, and the interval of their share; ``None`` without truth.
    """

    value: float
    interval: Interval
    expected: float
    expected_low: int
    expected_high: int
    normal: float | None
    counted: int | None
    counted_interval: Interval | None


@dataclass(frozen=True)
class DecisionRisk:
    """The risks of one quantity (``limit``; ``None``: all limits together).

    Parameters
    ----------
    judged, accepted, undecided : counts; undecided devices are not accepted.
    specific_mean, specific_most : mean and largest specific consumer's risk of the accepted devices; nan without any.
    consumer, producer : the global risks.
    """

    limit: Limit | None
    judged: int
    accepted: int
    undecided: int
    specific_mean: float
    specific_most: float
    consumer: RiskShare
    producer: RiskShare


@dataclass(frozen=True, eq=False)
class RiskCurve:
    """Yield and risks against the factor k of a guard band of k u, of all limits together.

    Parameters
    ----------
    k, accepted, consumer, producer : (K,) factors and shares of the judged devices.
    true_consumer, true_producer : (K,) counted by the truth; nan where it is unknown.
    """

    k: FloatArray
    accepted: FloatArray
    consumer: FloatArray
    producer: FloatArray
    true_consumer: FloatArray
    true_producer: FloatArray


def decision_risks(devices: Devices, limits: Limits, common: Common = MappingProxyType({})) -> tuple[DecisionRisk, ...]:
    """The risks of all limits together, then of each; empty if no device has a probability of conformity.

    ``common`` is that of :func:`reports.capability.capabilities`.
    """
    p_pass = devices.number("p_pass")
    judged = devices.is_ok() & np.isfinite(p_pass)
    if not judged.any():
        return ()
    groups = devices.wafers()
    good = _truth(devices, limits)
    total = _risk(None, judged, devices.has("pass"), devices.has("fail"), p_pass, good, groups, (None, None))
    return (total, *(_of_quantity(devices, limits.rule, limit, groups, common) for limit in limits.limits))


def _truth(devices: Devices, limits: Limits) -> BoolArray | None:
    checks = [devices.truth(limit) for limit in limits.limits]
    if not all(check.whole for check in checks):
        return None
    return np.asarray(np.logical_and.reduce([check.conforms for check in checks]))


def _of_quantity(devices: Devices, rule: Rule, limit: Limit, groups: CodedText, common: Common) -> DecisionRisk:
    value, u = devices.number(limit.quantity), devices.number(f"{limit.quantity}_sd")
    judged = devices.is_ok() & np.isfinite(value) & np.isfinite(u)
    p = np.full(value.size, np.nan)
    p[judged] = probability_inside(-np.stack(limit.beyond(value[judged])), u[judged])
    if rule.by_estimate:
        found = zones(rule, limit, value, u)
        accepted, rejected = found.conforms, found.violates
    else:
        accepted, rejected = p >= rule.pass_at, p <= rule.fail_at
    process = normal_process(devices, limit, common)
    normal = (None, None) if process is None else normal_risks(*process, limit, _guard_factor(rule))
    return _risk(limit, judged, accepted, rejected, p, _truth(devices, Limits(rule, (limit,))), groups, normal)


def _guard_factor(rule: Rule) -> float:
    """k of the guard band; of the rule "probability" that of a single limit."""
    return float(ndtri(rule.pass_at)) if rule.guard_factor is None else rule.guard_factor


def _risk(
    limit: Limit | None,
    judged: BoolArray,
    accepted: BoolArray,
    rejected: BoolArray,
    p: FloatArray,
    good: BoolArray | None,
    groups: CodedText,
    normal: tuple[float | None, float | None],
) -> DecisionRisk:
    rows = np.flatnonzero(judged)
    n = rows.size
    yes, p = accepted[rows], np.clip(p[rows], 0.0, 1.0)
    true = None if good is None else good[rows]
    present, group = numbered(groups.codes[rows])
    risk = 1.0 - p[yes]
    return DecisionRisk(
        limit,
        n,
        int(yes.sum()),
        int(n - yes.sum() - rejected[rows].sum()),
        float(risk.mean()) if risk.size else math.nan,
        float(risk.max()) if risk.size else math.nan,
        _share(np.where(yes, 1.0 - p, 0.0), group, present.size, normal[0], None if true is None else yes & ~true),
        _share(np.where(yes, 0.0, p), group, present.size, normal[1], None if true is None else ~yes & true),
    )


def _share(
    wrong: FloatArray, group: IntArray, groups: int, normal: float | None, counted: BoolArray | None
) -> RiskShare:
    n = wrong.size
    value = float(wrong.mean()) if n else math.nan
    # What is certain to a part in 10^9 need not be convolved.
    spread = measurement_uncertainty(np.where(wrong < _CERTAIN, 0.0, np.where(wrong > 1.0 - _CERTAIN, 1.0, wrong)))
    number = None if counted is None else int(counted.sum())
    return RiskShare(
        value,
        _interval(wrong, group, groups),
        spread.mean,
        spread.low,
        spread.high,
        normal,
        number,
        None if number is None else clopper_pearson(number, n),
    )


def _interval(wrong: FloatArray, group: IntArray, groups: int) -> Interval:
    n, value = wrong.size, float(wrong.mean()) if wrong.size else 0.0
    if groups < 2 or value in (0.0, 1.0):
        return clopper_pearson(value * n, n)
    found = effective_number(wrong, group, groups)
    return clopper_pearson(value * found.effective, found.effective)


def normal_risks(mean: float, sd: float, u: float, limit: Limit, k: float) -> tuple[float, float]:
    """Global consumer's and producer's risk of a normal process and measurement, with a guard band of k u inside each end.

    R_C = P(Y in A) - P(Y in A, X in C),  R_P = P(X in C) - P(Y in A, X in C)       (JCGM 106:2012, 9.5.3)

    Parameters
    ----------
    mean, sd : of the process [unit of the quantity].
    u : standard uncertainty of the measurement, same unit.
    limit : its limit, no axis.
    k : factor of the guard band.
    """
    low, high = (limit.low - mean) / sd, (limit.high - mean) / sd
    whole = math.hypot(sd, u)
    accept_low, accept_high = (limit.low + k * u - mean) / whole, (limit.high - k * u - mean) / whole
    if accept_low >= accept_high:
        return 0.0, float(ndtr(high) - ndtr(low))
    both = _rectangle((low, high), (accept_low, accept_high), sd / whole)
    accepted = float(ndtr(accept_high) - ndtr(accept_low))
    conforming = float(ndtr(high) - ndtr(low))
    return max(0.0, accepted - both), max(0.0, conforming - both)


def _rectangle(x: tuple[float, float], y: tuple[float, float], correlation: float) -> float:
    """P(x0 <= X <= x1, y0 <= Y <= y1) of standard normal X and Y."""
    parts = [(x[1], y[1], 1.0), (x[0], y[1], -1.0), (x[1], y[0], -1.0), (x[0], y[0], 1.0)]
    return float(sum(sign * bivariate_normal(h, k, correlation) for h, k, sign in parts))


def bivariate_normal(h: float, k: float, correlation: float) -> float:
    """P(X <= h, Y <= k) of standard normals with a correlation, by Owen's T function.

    1/2 (Phi(h) + Phi(k)) - T(h, a_h) - T(k, a_k) - d,  a_h = (k/h - r)/sqrt(1 - r^2),  d = 1/2 where h k < 0
    Owen 1956, Ann. Math. Stat. 27:1075, eq. 2.1.
    """
    if math.isinf(h) or math.isinf(k):
        if min(h, k) == -math.inf:
            return 0.0
        return float(ndtr(min(h, k)))
    root = math.sqrt(1.0 - correlation**2)
    if root == 0.0:
        return float(ndtr(min(h, k)))
    # T is continuous at 0, where its second argument is not defined; a product of these does not underflow.
    h, k = (one if abs(one) > 1e-150 else 1e-150 for one in (h, k))
    opposite = 0.5 if h * k < 0.0 else 0.0
    terms = owens_t(h, (k / h - correlation) / root) + owens_t(k, (h / k - correlation) / root)
    return float(0.5 * (ndtr(h) + ndtr(k)) - terms - opposite)


def risk_curve(devices: Devices, limits: Limits, k: FloatArray) -> RiskCurve | None:
    """The risks of guard bands of k u (K,), from the least distance d/u of each device; ``None`` if no device is judged.

    A guard band in terms of the consumer's risk is a curve of the same kind: k = z(1 - r) for one limit.
    """
    p_pass = devices.number("p_pass")
    judged = devices.is_ok() & np.isfinite(p_pass)
    if not judged.any():
        return None
    rows = np.flatnonzero(judged)
    least = np.full(rows.size, np.inf)
    for limit in limits.limits:
        value, u = (devices.number(name)[rows] for name in (limit.quantity, f"{limit.quantity}_sd"))
        inside = -np.max(np.stack(limit.beyond(value)), axis=0)
        with np.errstate(divide="ignore", invalid="ignore"):
            away = np.where(u > 0.0, inside / u, np.where(inside >= 0.0, np.inf, -np.inf))
        least = np.minimum(least, np.where(np.isnan(away), -np.inf, away))
    order = np.argsort(least)
    place = np.searchsorted(least[order], k, side="left")
    n = rows.size

    def above(values: FloatArray) -> FloatArray:
        return np.concatenate([np.cumsum(values[order][::-1])[::-1], [0.0]])[place] / n

    p = p_pass[rows]
    good = _truth(devices, limits)
    unknown = np.full(k.size, np.nan)
    true = None if good is None else good[rows].astype(np.float64)
    return RiskCurve(
        k,
        above(np.ones(n)),
        above(1.0 - p),
        float(p.mean()) - above(p),
        unknown if true is None else above(1.0 - true),
        unknown if true is None else float(true.mean()) - above(true),
    )
