"""Consumer's and producer's risk: wrong decisions, as shares of all devices.

    consumer's (global) = P(accepted and not conforming)
    producer's (global) = P(rejected and conforming)

JCGM 106:2012, section 9.  Predicted from the posteriors, or counted against a virtual truth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.arrays import BoolArray, FloatArray

from .coded import coded
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
    found = coded(verdicts)
    passed, failed = found.equals("pass") & known, found.equals("fail") & known
    return Risk(float(np.sum(1.0 - p_pass[passed])) / n, float(np.sum(p_pass[failed])) / n)


def counted_risk(verdicts: Sequence[str], conforming: BoolArray) -> CountedRisk:
    """Wrong passes and wrong fails against the truth, with B verdicts and ``conforming`` (B,)."""
    n = len(verdicts)
    found = coded(verdicts)
    wrong_pass = int(np.sum(found.equals("pass") & ~conforming))
    wrong_fail = int(np.sum(found.equals("fail") & conforming))
    return CountedRisk(n, wrong_pass, wrong_fail, clopper_pearson(wrong_pass, n), clopper_pearson(wrong_fail, n))
