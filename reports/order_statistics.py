"""Quantiles of many values: those of numpy to the last bit, from the few order statistics that they need.

    virtual place h = (n - 1) q,  k = floor(h),  t = h - k:    x_(k) + t (x_(k+1) - x_(k))

Hyndman and Fan 1996, Am. Stat. 50:361, definition 7.  numpy selects several order statistics of one array by a slower algorithm
than a single one: 1.2 instead of 8 ms of a million values for a median.

Shapes: n values, Q quantiles.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pipeline.arrays import FloatArray


def quantiles(values: FloatArray, q: Sequence[float]) -> FloatArray:
    """Quantiles (Q,) of values (n,), none of which is nan; nan where there are no values."""
    if not values.size:
        return np.full(len(q), np.nan)
    rest = values.copy()
    return np.array([_quantile(rest, one) for one in q])


def median(values: FloatArray) -> float:
    """The median of values (n,), none of which is nan; nan where there are no values."""
    if not values.size:
        return float("nan")
    upper = values.size // 2
    rest = np.partition(values, upper)
    # Half the sum, as numpy has it; a quantile adds half the difference, which may differ in the last bit.
    return float(rest[upper] if values.size % 2 else np.mean([rest[:upper].max(), rest[upper]]))


def _quantile(rest: FloatArray, q: float) -> float:
    """The quantile of ``rest`` (n,), whose order changes: a second quantile profits from that of the first."""
    place = (rest.size - 1) * q
    k = int(np.floor(place))
    rest.partition(k)
    if k + 1 >= rest.size:
        return float(rest[k])
    low, high, t = rest[k], rest[k + 1 :].min(), place - k
    # The end that is nearer is the base, so that the result never lies beyond both.
    return float(high - (high - low) * (1.0 - t) if t >= 0.5 else low + (high - low) * t)
