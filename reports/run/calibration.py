"""Calibration of this run: posteriors against the virtual truth as packaged.

    z = (estimate - truth)/sd,  inside: q05 <= truth <= q95 (an arc for an axis)

If the posteriors are right, 90 % of the truths lie inside and z has mean 0 and rms 1.  Only devices whose
identification is ok are counted.
"""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass

import numpy as np
from scipy.special import bdtr

from pipeline.arrays import FloatArray
from pipeline.axial import difference, in_arc
from pipeline.quantities import AXES, NAMES

from ..devices import Devices
from ..limits import Limits
from ..order_statistics import median
from ..yields import Interval, clopper_pearson

NOMINAL = 0.90


@dataclass(frozen=True)
class Coverage:
    """Calibration of one quantity.

    Parameters
    ----------
    quantity : its name.
    devices, inside : number of devices, and of those whose truth lies inside the 90 % interval.
    interval : Clopper-Pearson interval of the coverage.
    band : central 95 % of the binomial counts at 0.90, as shares; outside it the intervals are doubtful.
    z_median : median of z; 0 expected.
    z_rms : rms of z; 1 expected.
    beyond_3 : share of abs(z) > 3; 0.0027 expected of a normal posterior.
    """

    quantity: str
    devices: int
    inside: int
    interval: Interval
    band: tuple[float, float]
    z_median: float
    z_rms: float
    beyond_3: float

    @property
    def share(self) -> float:
        """inside / devices, the observed coverage."""
        return self.inside / self.devices

    @property
    def in_band(self) -> bool:
        """Whether the coverage is consistent with a nominal 0.90."""
        return self.band[0] <= self.share <= self.band[1]


@dataclass(frozen=True)
class VerdictCheck:
    """Verdicts against the truth.

    Parameters
    ----------
    table : (verdict, truth conforms, truth does not) counts.
    expected, expected_sd : number of conforming devices predicted by the posteriors, among those with a p_pass.
    found : number that do conform.
    """

    table: tuple[tuple[str, int, int], ...]
    expected: float
    expected_sd: float
    found: int


def z_scores(devices: Devices, quantity: str) -> FloatArray:
    """(n,) z = (estimate - truth) / sd of the n ok devices with estimate, truth and a positive sd."""
    estimate, truth = devices.number(quantity), devices.number(f"true_{quantity}")
    sd = devices.number(f"{quantity}_sd")
    miss = difference(estimate, truth) if quantity in AXES else estimate - truth
    usable = devices.is_ok() & np.isfinite(miss) & np.isfinite(sd) & (sd > 0.0)
    return np.asarray(miss[usable] / sd[usable])


def coverages(devices: Devices) -> tuple[Coverage, ...]:
    """Calibration of every quantity that has intervals and a truth, in the order of the results columns."""
    return tuple(row for row in (coverage(devices, name) for name in NAMES) if row is not None)


def coverage(devices: Devices, quantity: str) -> Coverage | None:
    """Calibration of one quantity; ``None`` where no device has an interval and a truth."""
    truth = devices.number(f"true_{quantity}")
    low, high = devices.number(f"{quantity}_q05"), devices.number(f"{quantity}_q95")
    usable = devices.is_ok() & np.isfinite(truth) & np.isfinite(low) & np.isfinite(high)
    n = int(usable.sum())
    z = z_scores(devices, quantity)
    if n == 0 or z.size == 0:
        return None
    within = in_arc(truth, low, high) if quantity in AXES else (truth >= low) & (truth <= high)
    inside = int(np.sum(within & usable))
    return Coverage(
        quantity,
        n,
        inside,
        clopper_pearson(inside, n),
        (_binomial_quantile(0.025, n) / n, _binomial_quantile(0.975, n) / n),
        median(z),
        float(np.sqrt(np.mean(z**2))),
        float(np.mean(np.abs(z) > 3.0)),
    )


def _binomial_quantile(q: float, n: int) -> int:
    """The least count k with P(K <= k) >= q, K binomial of n at ``NOMINAL``, by bisection."""
    return bisect_left(range(n + 1), q, key=lambda k: float(bdtr(k, n, NOMINAL)))


def check_verdicts(devices: Devices, limits: Limits) -> VerdictCheck | None:
    """Verdicts against the truth; ``None`` if no device has a truth for every limit."""
    checks = [devices.truth(limit) for limit in limits.limits]
    known = np.logical_and.reduce([check.finite for check in checks])
    if not known.any():
        return None
    good = np.logical_and.reduce([check.conforms for check in checks])
    p_pass = devices.number("p_pass")
    judged = known & np.isfinite(p_pass)
    return VerdictCheck(
        tuple(
            (
                verdict,
                int(np.sum(known & devices.has(verdict) & good)),
                int(np.sum(known & devices.has(verdict) & ~good)),
            )
            for verdict in ("pass", "undecided", "fail")
        ),
        float(np.sum(p_pass[judged])),
        float(np.sqrt(np.sum(p_pass[judged] * (1.0 - p_pass[judged])))),
        int(np.sum(good[judged])),
    )
