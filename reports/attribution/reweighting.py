"""The share of lost devices of a changed process, from devices of the present one.

    z -> s z with s = new spread / present spread:   w_i = prod over the changed numbers of device i of  N(z; 0, s^2) / N(z; 0, 1)
    share = sum w_i y_i / sum w_i,   effective lots with loss = (sum_l V_l)^2 / sum_l V_l^2,   V_l = sum of w_i y_i over lot l

The outcome of a device depends on its own numbers only, so these are all that enter its weight, whatever it shares with others.
sd: linearized ratio with whole lots as draws.  Interval: Student's t with lots - 1 degrees of freedom, on the logit scale for a
share.

Shapes: N devices, k changed numbers.
Source: Owen, Monte Carlo theory, methods and examples (2013), 9.2 to 9.4 (self-normalized weights, effective sample size); Korn,
Graubard, Analysis of Health Surveys (1999) (clusters, logit intervals).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

from pipeline.arrays import FloatArray, IntArray

from ..interval_estimate import IntervalEstimate
from ..yields import LEVEL

#: Below so many effective lots with loss, before or after, 95 % intervals hold in less than 90 % of cases, and for wider spreads,
#: whose devices were hardly drawn, even with more (``tests/reports/attribution/test_reweighting.py`` measures both).
LEAST_LOTS_WITH_LOSS = 12.0


@dataclass(frozen=True)
class ChangedShare:
    """A share of devices before and after a change, and the difference without the scatter that both have in common.

    ``lots_with_loss``: the effective number, before or after, whichever is smaller.
    """

    before: IntervalEstimate
    after: IntervalEstimate
    difference: IntervalEstimate
    lots_with_loss: float


def log_weights(z: FloatArray, factor: float) -> FloatArray:
    """ln w (N,) of devices with the changed numbers z (N, k) when their spread is multiplied by ``factor``."""
    count = z.shape[1]
    return np.asarray(-count * math.log(factor) - 0.5 * (factor**-2 - 1.0) * np.sum(z * z, axis=1))


def reweighted_share(y: FloatArray, lot: IntArray, log_w: FloatArray) -> ChangedShare:
    """Share of devices with y = 1 (N,) as drawn, and with weights; ``lot`` (N,) the lot of each device."""
    w = np.exp(log_w - log_w.max())
    return _changed(y, np.ones_like(w), y, w, lot)


def paired_share(before: FloatArray, after: FloatArray, lot: IntArray) -> ChangedShare:
    """Shares of two outcomes (N,), 0 or 1, of the same devices."""
    ones = np.ones(before.size)
    return _changed(before, ones, after, ones, lot)


def _changed(before: FloatArray, w0: FloatArray, after: FloatArray, w1: FloatArray, lot: IntArray) -> ChangedShare:
    _, index = np.unique(lot, return_inverse=True)
    sums: list[FloatArray] = [
        np.bincount(index, weights=w).astype(np.float64) for w in (w0, w0 * before, w1, w1 * after)
    ]
    shares = float(sums[1].sum() / sums[0].sum()), float(sums[3].sum() / sums[2].sum())
    influence = [
        (lost - share * whole) / whole.sum() for whole, lost, share in zip(sums[::2], sums[1::2], shares, strict=True)
    ]
    return ChangedShare(
        _on_logit(shares[0], influence[0]),
        _on_logit(shares[1], influence[1]),
        _plain(shares[1] - shares[0], influence[1] - influence[0], before.size),
        min(_effective(lost) for lost in sums[1::2]),
    )


def _effective(lost: FloatArray) -> float:
    square = float(lost @ lost)
    return float(lost.sum()) ** 2 / square if square > 0.0 else 0.0


def _sd(influence: FloatArray) -> tuple[float, float]:
    """sd and the half-width of its interval; ``influence`` (L,) what each lot adds to the error."""
    lots = influence.size
    if lots < 2:
        return math.inf, math.inf
    sd = math.sqrt(lots / (lots - 1.0) * float(influence @ influence))
    return sd, float(stdtrit(lots - 1.0, 0.5 * (1.0 + LEVEL))) * sd


def _plain(value: float, influence: FloatArray, devices: int) -> IntervalEstimate:
    sd, half = _sd(influence)
    if sd == 0.0:
        # Whether a device lies close enough to a limit to change is hardly common to its lot, unlike its loss.
        half = _rule_of_three(devices)
    return IntervalEstimate(value, sd, max(-1.0, value - half), min(1.0, value + half))


def _on_logit(share: float, influence: FloatArray) -> IntervalEstimate:
    sd, half = _sd(influence)
    if not 0.0 < share < 1.0:
        half = _rule_of_three(influence.size)
        return IntervalEstimate(share, sd, max(0.0, share - half), min(1.0, share + half))
    if not math.isfinite(half):
        return IntervalEstimate(share, sd, 0.0, 1.0)
    logit, width = math.log(share / (1.0 - share)), half / (share * (1.0 - share))
    return IntervalEstimate(share, sd, _expit(logit - width), _expit(logit + width))


def _expit(x: float) -> float:
    return 0.5 * (1.0 + math.tanh(0.5 * x))


def _rule_of_three(count: int) -> float:
    """None of ``count`` differs: at most 3 / count do.  Hanley, Lippman-Hand, JAMA 249 (1983) 1743."""
    return min(1.0, 3.0 / count)
