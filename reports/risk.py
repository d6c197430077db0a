"""Consumer's and producer's risk: wrong decisions, as shares of all devices.

    consumer's (global) = P(accepted and not conforming)
    producer's (global) = P(rejected and conforming)

JCGM 106:2012, section 9.  Predicted from the posteriors, counted against a virtual truth, or integrated
for a normal process and a normal measurement.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from pipeline.arrays import BoolArray, FloatArray

from .yields import Interval, clopper_pearson


@dataclass(frozen=True)
class Risk:
    """Consumer's and producer's global risk, as shares of all devices."""

    consumer: float
    producer: float


@dataclass(frozen=True)
class CountedRisk:
    """Wrong decisions counted against the truth, with Clopper-Pearson intervals of their shares."""

    devices: int
    wrong_pass: int
    wrong_fail: int
    consumer: Interval
    producer: Interval


def normal_risk(
    process_sd: float, measurement_sd: float, tolerance: tuple[float, float], acceptance: tuple[float, float]
) -> Risk:
    """Risks of a rule that accepts if the measured y lies in the acceptance interval (JCGM 106:2012, section 9).

    x ~ N(0, u0), y given x ~ N(x, u).

        consumer's = int over x outside the tolerance of N(x; 0, u0) P(y accepted | x) dx,   producer's likewise

    Parameters
    ----------
    process_sd, measurement_sd : u0 and u, in the unit of the quantity.
    tolerance, acceptance : (low, high) about the process mean; the ends of ``acceptance`` may be guard-banded.
    """

    def accepted(x: float) -> float:
        high, low = ndtr((np.asarray(acceptance)[::-1] - x) / measurement_sd)
        return float(high - low)

    def density(x: float) -> float:
        return math.exp(-0.5 * (x / process_sd) ** 2) / (process_sd * math.sqrt(2.0 * math.pi))

    def wrong_pass(x: float) -> float:
        return density(x) * accepted(x)

    def wrong_fail(x: float) -> float:
        return density(x) * (1.0 - accepted(x))

    # The probability beyond ten sd is below the resolution of a double.
    reach = 10.0 * process_sd
    low, high = np.clip(tolerance, -reach, reach)
    outside = _integral(wrong_pass, -reach, low) + _integral(wrong_pass, high, reach)
    return Risk(outside, _integral(wrong_fail, low, high))


def _integral(integrand: Callable[[float], float], low: float, high: float) -> float:
    from scipy.integrate import quad

    return float(quad(integrand, low, high, epsabs=1e-13, epsrel=1e-12, limit=200)[0]) if high > low else 0.0


def expected_risk(p_pass: FloatArray, verdicts: Sequence[str]) -> Risk:
    """consumer's = sum over passed (1 - p) / n, producer's = sum over failed p / n, n = number of devices with a p.

    Parameters
    ----------
    p_pass : (B,) posterior probability of conformity; nan where unknown.
    verdicts : B verdicts.
    """
    known = np.isfinite(p_pass)
    n = int(known.sum())
    if n == 0:
        return Risk(float("nan"), float("nan"))
    passed = np.array([verdict == "pass" for verdict in verdicts], dtype=np.bool_) & known
    failed = np.array([verdict == "fail" for verdict in verdicts], dtype=np.bool_) & known
    return Risk(float(np.sum(1.0 - p_pass[passed])) / n, float(np.sum(p_pass[failed])) / n)


def counted_risk(verdicts: Sequence[str], conforming: BoolArray) -> CountedRisk:
    """Wrong passes and wrong fails against the truth, with B verdicts and ``conforming`` (B,)."""
    n = len(verdicts)
    wrong_pass = sum(verdict == "pass" and not good for verdict, good in zip(verdicts, conforming, strict=True))
    wrong_fail = sum(verdict == "fail" and bool(good) for verdict, good in zip(verdicts, conforming, strict=True))
    return CountedRisk(n, wrong_pass, wrong_fail, clopper_pearson(wrong_pass, n), clopper_pearson(wrong_fail, n))
