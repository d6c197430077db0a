"""Process capability of the limited quantities, with intervals.

    Cp  = (USL - LSL) / (6 sigma_w),   Cpk = min(USL - mu, mu - LSL) / (3 sigma_w)       sigma_w: within wafers
    Pp, Ppk the same with sigma: over all devices, wafers and lots (s^2 of ``reports.clustered``)
    sigma^2 = s^2 - v          v = mean(u^2 - sum_e a_e^2) + sum_e var(a_e): the spread of the product, not of its test

    Cp, Pp    interval from that of s^2, less v; of chi2 without groups
    Cpk, Ppk  +- q sqrt(var(mean)/(9 sigma^2) + Cpk^2 (s^2/sigma^2)^2 / (2 nu))

u is the standard uncertainty of each device, and a_e its shift by one sd of an error e that all devices of the tester share.
Such an error moves the mean, and spreads the devices only as far as it shifts them unequally.

nu are the effective degrees of freedom of s^2 with lots and wafers as groups (``reports.clustered``), and var(mean) is the
variance of the mean with the coarsest groups as draws, and sum_e mean(a_e)^2.  q is 1.96 for independent devices, which gives
Bissell's interval, and a Student quantile with the degrees of freedom of the sum (Satterthwaite) where there are groups.  Without
groups Cp = Pp.

An axis (theta) is measured from its axial mean, and its limits are the arc; no index is given where 3 sigma exceeds 90 deg: the
axis then points everywhere.  The indices describe a normal process: ``outside`` says which share such a process puts outside,
beside what the devices show.

Shapes: B devices, n of them used.
Sources: AIAG, Statistical Process Control (2005), ch. IV; Bissell 1990, Appl. Stat. 39:331; Chou, Owen, Borrego 1990, J. Qual.
Technol. 22:223; ISO 22514-7:2021 (measurement uncertainty in capability).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from scipy.special import ndtr, stdtrit

from pipeline.arrays import BoolArray, FloatArray
from pipeline.axial import mean_axis, wrap

from .acceptance import probability_inside
from .clustered import NestedSpread, nested_spread
from .coded import IntArray
from .devices import Devices
from .limits import Limit, Limits
from .yields import LEVEL

#: Fewest devices of an index: the 95 % interval of a sd from 8 devices is a factor of 3 wide.
LEAST_DEVICES = 8


@dataclass(frozen=True)
class Index:
    """A capability index with its 95 % interval; an infinite end is not bounded by these devices."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Capability:
    """Capability of one quantity.

    Parameters
    ----------
    limit : its limit.
    devices, groups : devices used, and groups of each level (lots, wafers).
    mean, sigma, sigma_within, uncertainty : of the process [unit of the quantity]; the last is the rms of u.
    cp, cpk, pp, ppk : the indices; ``None`` where there is none: Cp and Pp with one limit, all of them for the ``reason``.
    outside : share outside the limits of a normal process with mean and sigma.
    found_outside : share outside by the estimates and uncertainties of the devices.
    reason : why there is no index, or "".
    """

    limit: Limit
    devices: int
    groups: tuple[int, ...]
    mean: float
    sigma: float
    sigma_within: float
    uncertainty: float
    cp: Index | None
    cpk: Index | None
    pp: Index | None
    ppk: Index | None
    outside: float
    found_outside: float
    reason: str


Common = Mapping[str, FloatArray]


def capabilities(devices: Devices, limits: Limits, common: Common = MappingProxyType({})) -> tuple[Capability, ...]:
    """Capability of each limited quantity, from the devices whose identification is ok.

    Parameters
    ----------
    devices, limits : of the run.
    common : quantity -> (E, B) a_e [its unit]; a quantity that is left out has none.
    """
    lots, wafers = devices.text("lot"), devices.wafers()
    levels = [text.codes for text in (lots, wafers) if len(text) and all(text.counts())]
    return tuple(_capability(devices, limit, levels, common) for limit in limits.limits)


def _capability(devices: Devices, limit: Limit, levels: list[IntArray], common: Common) -> Capability:
    used, x, u = _used(devices, limit)
    low, high = limit.low, limit.high
    if x.size < LEAST_DEVICES:
        return _none(limit, x.size, "few")
    found_outside = float(np.mean(1.0 - probability_inside(-np.stack(limit.beyond(x)), u)))
    if limit.axis:
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
        centre = mean_axis(x)
        x, low, high = wrap(x - centre) + float(wrap(centre - middle)), -half, half
    spread = nested_spread(x, [codes[used] for codes in levels])
    shift = _shift(limit, common, used)
    noise = _noise(u, shift)
    spread = replace(spread, mean_variance=spread.mean_variance + float(np.sum(np.mean(shift, axis=1) ** 2)))
    if limit.axis and 3.0 * math.sqrt(spread.total) > 90.0:
        return _none(limit, x.size, "axis")
    mean = float(wrap(spread.mean + middle)) if limit.axis else spread.mean
    sigma, sigma_within = (math.sqrt(max(0.0, s2 - noise)) for s2 in (spread.total, spread.within))
    with np.errstate(divide="ignore"):
        ends = [end for end in ((high - spread.mean), (spread.mean - low)) if math.isfinite(end)]
        outside = float(np.sum(ndtr(-np.array(ends) / sigma))) if sigma > 0.0 else float(min(ends) < 0.0)
    within = _indices(spread, spread.within, spread.within_df, spread.within_interval, noise, low, high)
    overall = _indices(spread, spread.total, spread.total_df, spread.total_interval, noise, low, high)
    rms_u = math.sqrt(float(np.mean(u**2)))
    indices = (*within, *overall)
    return Capability(
        limit, x.size, spread.groups, mean, sigma, sigma_within, rms_u, *indices, outside, found_outside, ""
    )


def _used(devices: Devices, limit: Limit) -> tuple[BoolArray, FloatArray, FloatArray]:
    """(B,) whether a device is used, and the value and u (n,) of those that are."""
    value, u = devices.number(limit.quantity), devices.number(f"{limit.quantity}_sd")
    used = devices.is_ok() & np.isfinite(value) & np.isfinite(u)
    return used, value[used], u[used]


def _shift(limit: Limit, common: Common, used: BoolArray) -> FloatArray:
    """a_e (E, n) of the devices used; E = 0 without common errors."""
    found = common.get(limit.quantity)
    return np.zeros((0, int(used.sum()))) if found is None else np.asarray(np.nan_to_num(found[:, used]))


def _noise(u: FloatArray, shift: FloatArray) -> float:
    """v, the part of s^2 that the measurement adds."""
    own = np.maximum(u**2 - np.sum(shift**2, axis=0), 0.0)
    return float(np.mean(own) + np.sum(np.var(shift, axis=1)))


def _none(limit: Limit, devices: int, reason: str) -> Capability:
    unknown = float("nan")
    return Capability(
        limit, devices, (), unknown, unknown, unknown, unknown, None, None, None, None, unknown, unknown, reason
    )


def _indices(
    spread: NestedSpread, s2: float, df: float, interval: tuple[float, float], noise: float, low: float, high: float
) -> tuple[Index | None, Index | None]:
    """Cp and Cpk of a process with the variance s2 (``df`` degrees of freedom, ``interval``), ``noise`` of it by measurement."""
    sigma2 = s2 - noise
    width = high - low
    cp = None
    if math.isfinite(width):
        cp = Index(*(_ratio(width, variance - noise) for variance in (s2, interval[1], interval[0])))
    margin = min(high - spread.mean, spread.mean - low)
    if sigma2 <= 0.0:
        value = math.copysign(math.inf, margin)
        return cp, Index(value, -math.inf, math.inf)
    value = margin / (3.0 * math.sqrt(sigma2))
    of_mean, of_sigma = spread.mean_variance / (9.0 * sigma2), value**2 * (s2 / sigma2) ** 2 / (2.0 * df)
    half = _quantile(spread, of_mean, of_sigma, df) * math.sqrt(of_mean + of_sigma)
    return cp, Index(value, value - half, value + half)


def _ratio(width: float, sigma2: float) -> float:
    return width / (6.0 * math.sqrt(sigma2)) if sigma2 > 0.0 else math.inf


def _quantile(spread: NestedSpread, of_mean: float, of_sigma: float, df: float) -> float:
    """1.96 without groups, else Student's quantile with the degrees of freedom of the sum of both variances."""
    if not spread.groups:
        return 1.959963984540054
    parts = of_mean**2 / spread.mean_df + of_sigma**2 / df
    return float(stdtrit((of_mean + of_sigma) ** 2 / parts, 0.5 * (1.0 + LEVEL)))


def normal_process(
    devices: Devices, limit: Limit, common: Common = MappingProxyType({})
) -> tuple[float, float, float] | None:
    """Mean, sd and rms u [unit of the quantity] of a process that is no axis: the prior of a global risk, if any."""
    if limit.axis:
        return None
    used, x, u = _used(devices, limit)
    if x.size < LEAST_DEVICES:
        return None
    spread = nested_spread(x, [])
    sigma = math.sqrt(max(0.0, spread.total - _noise(u, _shift(limit, common, used))))
    return (spread.mean, sigma, math.sqrt(float(np.mean(u**2)))) if sigma > 0.0 else None
