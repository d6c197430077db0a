"""The content of a trend: frozen data from nights, without HTML and figures.

nights (oldest first, tonight last) -> charts, alarms, comparison with one earlier night -> TrendContent -> JSON, page
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from pipeline.arrays import FloatArray

from ..limits import Limit
from ..limits_origin import LimitsOrigin
from .chart import BEFORE, ChartSeries, anscombe, judged, share_at, share_of
from .charted import CHARTED, YIELD
from .difference import FAMILY, Comparison
from .night import NightSummary
from .rules import WESTERN_ELECTRIC, RunRule

#: Probability that a night in control raises any alarm, where the user states none.
FALSE_ALARM = 0.01


@dataclass(frozen=True)
class InputChange:
    """What differs between the inputs of two runs: the group, the key, and the value before and after."""

    what: str
    key: str
    before: str
    after: str


@dataclass(frozen=True)
class LeftOutNight:
    """A run that is not in the charts, and why; ``charts`` names those that it is missing from, empty: all."""

    run_id: str
    reason: str
    charts: tuple[str, ...] = ()


@dataclass(frozen=True)
class TrendPoint:
    """One night on a chart: value with interval, limits of one night alone and Q, nan where unknown, and the rules it breaks."""

    run_id: str
    created: str
    value: float
    low: float
    high: float
    centre: float
    low_limit: float
    high_limit: float
    q: float
    broken: tuple[str, ...]


@dataclass(frozen=True)
class TrendChart:
    """The nights of one quantity, oldest first, and the rules that judge the last one; none with too few nights."""

    name: str
    unit: str
    points: tuple[TrendPoint, ...]
    rules: tuple[RunRule, ...]
    false_alarm: float

    @property
    def tonight(self) -> TrendPoint:
        """The last night."""
        return self.points[-1]


@dataclass(frozen=True)
class Alarm:
    """A chart whose last night breaks a rule, or a limit that the user set on the value of a night."""

    name: str
    rule: str
    value: float
    low: float
    high: float


@dataclass(frozen=True)
class TrendContent:
    """All content of a trend; ``false_alarm`` is that of all charts together.

    ``gated``: whether alarms of the charts decide the exit code; limits that the user set always do.  ``limits``: where those
    come from by which the devices of the run were judged.
    """

    run_id: str
    created: str
    devices: int
    comparison: Comparison | None
    changes: tuple[InputChange, ...]
    charts: tuple[TrendChart, ...]
    nights: tuple[str, ...]
    left_out: tuple[LeftOutNight, ...]
    false_alarm: float
    alarms: tuple[Alarm, ...]
    broken_limits: tuple[Alarm, ...]
    gated: bool
    limits: LimitsOrigin

    @property
    def negative(self) -> tuple[Alarm, ...]:
        """What sets the exit code 1."""
        return (*(self.alarms if self.gated else ()), *self.broken_limits)

    def to_dict(self) -> dict[str, Any]:
        """Plain data for JSON; unknown and infinite numbers are null."""
        plain: dict[str, Any] = _plain(asdict(self))
        for row, one in zip(
            (plain["comparison"] or {}).get("differences", []), self.comparison.differences if self.comparison else ()
        ):
            row["differs"] = one.differs
        return plain | {"family": FAMILY, "limits": self.limits.to_dict()}


def charts_of(
    nights: Sequence[NightSummary], names: Sequence[str], false_alarm: float, yields: Sequence[bool]
) -> tuple[TrendChart, ...]:
    """A chart of the yield and of each quantity in ``names``; together they alarm at ``false_alarm``.

    Parameters
    ----------
    nights : oldest first; the last one is judged.
    yields : for each night, whether its yield can be compared: it was judged by the same limits.
    """
    rate = share_of(false_alarm, 1 + len(names))
    same = [night for night, comparable in zip(nights, yields, strict=True) if comparable]
    return (_yield_chart(same, rate), *(_chart(nights, name, rate) for name in names))


def _yield_chart(nights: Sequence[NightSummary], rate: float) -> TrendChart:
    count = np.array([float(night.passed) for night in nights])
    angle, least = anscombe(count, np.array([float(night.devices) for night in nights]))
    # Between nights a yield scatters at least as much as devices do by chance.
    found = judged(angle, rate, least)
    limits = tuple(share_at(one) for one in (found.centre, found.low, found.high))
    ends = [(night.interval.low, night.interval.high) for night in nights]
    return TrendChart(
        YIELD, "1", _points(nights, np.array([night.share for night in nights]), ends, limits, found), found.rules, rate
    )


def _chart(nights: Sequence[NightSummary], name: str, rate: float) -> TrendChart:
    means = [night.means[name] for night in nights]
    known = [k for k, mean in enumerate(means) if math.isfinite(mean.value)]
    shown = [nights[k] for k in known]
    values = np.array([means[k].value for k in known])
    found = judged(values, rate)
    ends = [means[k].interval() for k in known]
    return TrendChart(
        name,
        CHARTED[name],
        _points(shown, values, ends, (found.centre, found.low, found.high), found),
        found.rules,
        rate,
    )


def _points(
    nights: Sequence[NightSummary],
    values: FloatArray,
    ends: Sequence[tuple[float, float]],
    limits: Sequence[FloatArray],
    found: ChartSeries,
) -> tuple[TrendPoint, ...]:
    centre, low, high = limits
    names = [rule.name for rule in WESTERN_ELECTRIC]
    return tuple(
        TrendPoint(
            night.run_id,
            night.created,
            float(values[k]),
            ends[k][0],
            ends[k][1],
            float(centre[k]),
            float(low[k]),
            float(high[k]),
            float(found.q[k]),
            tuple(name for name, broken in zip(names, found.broken[k]) if broken),
        )
        for k, night in enumerate(nights)
    )


def chart_alarms(charts: Sequence[TrendChart], run_id: str) -> tuple[Alarm, ...]:
    """The rules that the night ``run_id`` breaks, chart by chart."""
    return tuple(
        Alarm(chart.name, rule, point.value, point.low_limit, point.high_limit)
        for chart in charts
        for point in chart.points[-1:]
        if point.run_id == run_id
        for rule in point.broken
    )


def limit_alarms(night: NightSummary, limits: Sequence[Limit]) -> tuple[Alarm, ...]:
    """The limits on yield and means of a night that it breaks; an unknown value breaks them."""
    values = {
        limit.quantity: night.share if limit.quantity == YIELD else night.means[limit.quantity].value
        for limit in limits
    }
    return tuple(
        Alarm(limit.quantity, "limit", values[limit.quantity], limit.low, limit.high)
        for limit in limits
        if not bool(limit.admits(np.array(values[limit.quantity])))
    )


def enough(chart: TrendChart) -> bool:
    """Whether the last night of a chart could be judged."""
    return len(chart.points) > BEFORE


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(one) for one in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
