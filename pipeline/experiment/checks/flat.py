"""Flat maxima: samples that stay at exactly the same extreme value, at whatever level, as behind a limiter.

A smooth maximum that is sampled m times within one step q of its converter is, near its top, a parabola c (t - delta)^2 with
c ((m - 1)/2 + |delta|)^2 <= q.  The samples just outside of the run then lie below it by

    d_before + d_after <= 2 c [((m + 1)/2)^2 + delta^2] <= 2 q ((m + 1)/(m - 1))^2        (delta = 0 is the worst)

up to one step of rounding.  A run of three or more samples that is entered and left by more is flat.  A sine has none, however
densely it is sampled or coarsely rounded.  A held or a switched signal has such runs at other values too, and is not clipped.

Shapes: y (N,) samples of one channel.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...arrays import FloatArray

#: Runs at the extremes that count as a limiter.  One or two come about by chance where noise is as large as a step.
_MIN_RUNS = 3
#: A signal with fewer values is switched between levels.
_FEWEST_VALUES = 16


def _values(y: FloatArray) -> int:
    """How many different values y (N,) has, of at most 2^18 samples."""
    return int(np.unique(y[:: max(1, y.size >> 18)]).size)


@dataclass(frozen=True)
class Flat:
    """Flat runs at one or both extremes: their ``level`` (that with more samples), number, and samples in them."""

    level: float
    runs: int
    samples: int


def flat_extreme(y: FloatArray, step: float | None) -> Flat | None:
    """The flat extremes of y (N,), whose values are ``step`` apart (``None``: on no grid); ``None`` where it has none."""
    high, low = float(y.max()), float(y.min())
    if int(np.sum(y == high)) + int(np.sum(y == low)) < 3 * _MIN_RUNS:
        return None
    q = step or 1e-12 * max(abs(high), abs(low))
    edges = np.concatenate([[0], np.flatnonzero(y[1:] != y[:-1]) + 1, [y.size]])
    # The first and the last run have no neighbour on one side.
    starts, stops = edges[1:-2], edges[2:-1]
    long = stops - starts >= 3
    starts, stops = starts[long], stops[long]
    count = (stops - starts).astype(np.float64)
    before, after = y[starts] - y[starts - 1], y[starts] - y[stops]
    jump = 2.0 * q * ((count + 1.0) / (count - 1.0)) ** 2 + q
    sharp = np.abs(before) + np.abs(after) > jump
    extreme = sharp & (before * after > 0.0) & ((y[starts] == high) | (y[starts] == low))
    # Pulses between pauses at zero have a flat minimum there.
    extreme &= np.abs(y[starts]) > 1e-9 * (high - low)
    runs = int(extreme.sum())
    # In the outer half, where a limiter leaves no others; near zero, idle signals change by rare steps.
    others = sharp & ~extreme & (np.abs(y[starts] - 0.5 * (high + low)) > 0.25 * (high - low))
    if runs < _MIN_RUNS or int(others.sum()) > runs or _values(y) < _FEWEST_VALUES:
        return None
    at, samples = y[starts][extreme], count[extreme]
    level = max((high, low), key=lambda value: float(samples[at == value].sum()))
    return Flat(level, runs, int(samples.sum()))
