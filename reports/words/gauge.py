"""Gauge R&R in words."""

from __future__ import annotations

from collections.abc import Sequence

from ..gauge import GaugeComponent, GaugeStudy
from ..interval_estimate import IntervalEstimate
from .numbers import number
from .quantities import UNITS

#: AIAG, Measurement Systems Analysis, 4th ed. (2010), ch. II D: % GRR below 10 is acceptable, above 30 is not; 5 categories.
ACCEPTABLE, LIMIT, CATEGORIES = 10.0, 30.0, 5


def gauge_lines(studies: Sequence[GaugeStudy]) -> list[str]:
    """What ``gyroscreen grr`` prints."""
    lines = [line for study in studies for line in _study_lines(study)]
    return [
        *lines,
        "in brackets: 95 % intervals; study: % of the total sd; tolerance: % of the limits for 6 sd (3 sd to one limit)",
    ]


def _study_lines(study: GaugeStudy) -> list[str]:
    unit = UNITS.get(study.quantity, "")
    head = (
        f"{study.quantity}{f' [{unit}]' if unit else ''}: {study.measurements} measurements of {study.parts} parts,"
        f" {study.testers} testers, {study.sessions} sessions"
    )
    width = max(len(one.name) for one in study.components)
    lines = [head, *(_component_line(one, width) for one in study.components)]
    lines.append(f"    distinct categories: {categories(study)} ({_ends(study.categories)}); {verdict(study)}")
    if study.pooled:
        lines.append("    part x tester is not significant, or not repeated, and counts as repeatability")
    if study.unknown:
        lines.append(f"    not shown by this design: {', '.join(study.unknown)}")
    return lines


def _component_line(one: GaugeComponent, width: int) -> str:
    tolerance = (
        "" if one.tolerance is None else f"  tolerance {number(one.tolerance.value, 3)} % ({_ends(one.tolerance)})"
    )
    df = "" if one.df is None else f"  {one.df} df"
    sd = f"sd {number(one.sd.value, 3)} ({_ends(one.sd)})"
    return f"    {one.name:{width}s}  {sd}  study {number(one.study.value, 3)} % ({_ends(one.study)}){tolerance}{df}"


def _ends(found: IntervalEstimate) -> str:
    return f"{number(found.low, 3)} to {number(found.high, 3)}"


def categories(study: GaugeStudy) -> str:
    """The number of distinct categories, truncated as AIAG does, at least 1."""
    value = study.categories.value
    return number(max(float(int(value)), 1.0)) if value < 1e6 else "more than a million"


def verdict(study: GaugeStudy) -> str:
    """AIAG's verdict, by the estimate of % study variation and by the whole interval."""
    share = study.component("GRR").study
    words = _verdict_of(share.value)
    ends = {_verdict_of(share.low), _verdict_of(share.high)}
    return words if ends == {words} else f"{words}, but the interval also allows: {', '.join(sorted(ends - {words}))}"


def _verdict_of(percent: float) -> str:
    if percent < ACCEPTABLE:
        return "acceptable"
    return "may be acceptable" if percent <= LIMIT else "not acceptable"
