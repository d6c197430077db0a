"""A value with its sd and its interval."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class IntervalEstimate:
    """A value with its sd and the ends of its interval at ``reports.yields.LEVEL``, all in one unit."""

    value: float
    sd: float
    low: float
    high: float
