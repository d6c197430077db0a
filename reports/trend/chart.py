"""A control chart of single nights whose mean and spread are not known beforehand.

Night i is judged by the i - 1 nights before it, which give the mean m and the sd s *between nights*:

    Q_i = Phi^-1( T_{i-2}( sqrt((i - 1) / i) (x_i - m) / s ) ),   i = 3, 4, ..

Of independent normal nights in control the Q_i are independent and N(0, 1), whatever mean and spread are and however few nights
there are, so the run rules have their stated rate exactly.  A limit z of a rule is, in the unit of x, the prediction limit

    m +- t_{i-2}(Phi(z)) s sqrt(i / (i - 1))

The scatter within a night is not used as a spread between nights: lots differ, so it would be too small.

Shapes: T nights, oldest first.
Source: Quesenberry, J. Quality Technology 23 (1991) 213 and 25 (1993) 95 (Q charts); Montgomery, Introduction to Statistical
Quality Control, ch. 6 (charts for single values) and ch. 10 (start-up and short runs).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr, ndtri, stdtr, stdtrit

from pipeline.arrays import BoolArray, FloatArray

from .rules import RunRule, alarms, calibrated

#: Nights before the first one that can be judged.
BEFORE = 2


@dataclass(frozen=True, eq=False)
class ChartSeries:
    """A chart: ``centre``, ``low``, ``high`` (T,) are mean and limits of one night alone, ``q`` (T,) the Q statistics.

    nan where there are too few nights before.  ``rules`` are those of the last night, and ``broken`` (T, 4) tells which of the
    rules of Western Electric each night breaks.
    """

    centre: FloatArray
    low: FloatArray
    high: FloatArray
    q: FloatArray
    broken: BoolArray
    rules: tuple[RunRule, ...]


def earlier(values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean and sd (..., T) of the nights before each of ``values`` (..., T); nan where there are fewer than two."""
    count = np.arange(values.shape[-1], dtype=np.float64)
    # Relative to the first night, so that a small spread about a large mean is not lost to rounding.
    first = values[..., :1]
    shifted = values - first
    zero = np.zeros_like(first)
    total = np.concatenate([zero, np.cumsum(shifted, axis=-1)[..., :-1]], axis=-1)
    square = np.concatenate([zero, np.cumsum(shifted**2, axis=-1)[..., :-1]], axis=-1)
    known = count >= BEFORE
    n = np.where(known, count, np.nan)
    mean = total / n
    variance = np.maximum(square - n * mean**2, 0.0) / (n - 1.0)
    return mean + first, np.sqrt(variance)


def q_statistics(values: FloatArray, least_sd: FloatArray | float = 0.0) -> FloatArray:
    """Q (..., T) of the nights ``values`` (..., T); nan for the first two.

    ``least_sd`` (..., T) is the smallest sd that a night can have, 0 where none is known: with it the rate of false alarms is at
    most the stated one.  Nights without any spread give 0, or infinity for one that differs from them.
    """
    mean, sd = earlier(values)
    count = np.arange(values.shape[-1], dtype=np.float64)
    sd = np.where(np.isfinite(sd), np.maximum(sd, least_sd), np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        away = values - mean
        t = np.where(away == 0.0, 0.0, away / sd * np.sqrt(count / (count + 1.0)))
    known = np.isfinite(sd)
    freedom = np.maximum(count - 1.0, 1.0)
    # The tail is computed on its own side: 1 - T would be rounded to nothing.
    tail = stdtr(freedom, -np.abs(np.where(known, t, 0.0)))
    return np.where(known, -np.sign(np.where(known, t, 0.0)) * ndtri(tail), np.nan)


def prediction(
    values: FloatArray, limit: FloatArray, least_sd: FloatArray | float = 0.0
) -> tuple[FloatArray, FloatArray]:
    """Prediction limits (T,) of each night for the limits (T,) [sd of a normal]; nan for the first two."""
    mean, sd = earlier(values)
    count = np.arange(values.size, dtype=np.float64)
    sd = np.where(np.isfinite(sd), np.maximum(sd, least_sd), np.nan)
    known = np.isfinite(sd) & np.isfinite(limit)
    reach = -stdtrit(np.maximum(count - 1.0, 1.0), ndtr(-np.where(known, limit, 0.0)))
    half = reach * sd * np.sqrt((count + 1.0) / np.maximum(count, 1.0))
    return np.where(known, mean - half, np.nan), np.where(known, mean + half, np.nan)


def judged(values: FloatArray, rate: float, least_sd: FloatArray | float = 0.0) -> ChartSeries:
    """The chart of ``values`` (T,), where a night in control alarms at ``rate``."""
    nights = values.size
    q = q_statistics(values, least_sd)
    broken = np.zeros((nights, 4), dtype=np.bool_)
    limit = np.full(nights, np.nan)
    rules: tuple[RunRule, ...] = ()
    for i in range(BEFORE, nights):
        rules = calibrated(rate, i + 1 - BEFORE)
        limit[i] = rules[0].limit
        broken[i, : len(rules)] = alarms(q[BEFORE : i + 1], rules)
    low, high = prediction(values, limit, least_sd)
    return ChartSeries(earlier(values)[0], low, high, q, broken, rules)


def share_of(rate: float, charts: int) -> float:
    """The rate of each of several charts that alarm at ``rate`` together: 1 - (1 - rate)^(1/K).

    Exact for independent charts.  Charts that move together alarm together, so that a night then alarms less often (Sidak 1967,
    J. Am. Stat. Assoc. 62:626, for limits on both sides of normal values of any correlation).
    """
    return float(-np.expm1(np.log1p(-rate) / max(charts, 1)))


def anscombe(count: FloatArray, n: FloatArray) -> tuple[FloatArray, FloatArray]:
    """arcsin sqrt((x + 3/8) / (n + 3/4)) [rad] of x passed of n, and its binomial sd 1 / sqrt(4 n + 2).

    On this scale the scatter does not depend on the yield.  Anscombe 1948, Biometrika 35:246.
    """
    return np.arcsin(np.sqrt((count + 0.375) / (n + 0.75))), 1.0 / np.sqrt(4.0 * n + 2.0)


def share_at(angle: FloatArray) -> FloatArray:
    """The yield at an angle [rad] of :func:`anscombe`, of a night with many devices."""
    return np.where(np.isnan(angle), np.nan, np.sin(np.clip(angle, 0.0, 0.5 * np.pi)) ** 2)
