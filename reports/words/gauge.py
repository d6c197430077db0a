"""Gauge R&R in words."""

from __future__ import annotations

from collections.abc import Sequence

from ..gauge import GaugeComponent, GaugeStudy
from ..interval_estimate import IntervalEstimate
from .numbers import number
from .quantities import UNITS, label

#: AIAG, Measurement Systems Analysis, 4th ed. (2010), ch. II D: % GRR below 10 is acceptable, above 30 is not; 5 categories.
ACCEPTABLE, LIMIT, CATEGORIES = 10.0, 30.0, 5
#: The components that the chart of variation shows.
BARS = ("GRR", "repeatability", "reproducibility", "part")
#: How to read the charts of the page.
READING = (
    "Components of variation: sd in % of the total sd of the study, and of the tolerance; lines are 95 % intervals, cut at the"
    " edge. An interval with few degrees of freedom is wide: two or three testers say little about all testers.",
    "sd of the repeats: of each part by each tester, within sessions. Band: 3 sd limits from the repeatability. A circle beyond"
    " it is a part that a tester does not repeat as well as the others.",
    "Means of the parts: by each tester. Band: 3 sd limits from the repeatability alone. The measurement resolves the parts"
    " where most means lie beyond the band, so here circles are good.",
    "Part by tester: parallel lines mean that testers differ alike for all parts. Crossing lines are part x tester.",
)


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
    return [*lines, *(f"    {sentence}" for sentence in remarks(study))]


def remarks(study: GaugeStudy) -> list[str]:
    """What the design does not show."""
    lines = []
    if study.pooled:
        lines.append("part x tester is not significant, or not repeated, and counts as repeatability")
    if study.unknown:
        lines.append(f"not shown by this design: {', '.join(study.unknown)}")
    return lines


def headline(studies: Sequence[GaugeStudy]) -> str:
    """The quantity that is measured worst, by its share of the study variation."""
    worst = max(studies, key=lambda one: one.component("GRR").study.value)
    share = worst.component("GRR").study
    return f"GRR of {label(worst.quantity)}: {number(share.value, 3)} % of the study variation ({_ends(share)}), {verdict(worst)}"


def study_sentence(study: GaugeStudy) -> str:
    """Design and verdict of a study."""
    counts = f"{study.measurements} measurements of {study.parts} parts by {study.testers} testers in {study.sessions} sessions"
    return f"{counts}. AIAG: {verdict(study)}. Distinct categories: {categories(study)} ({_ends(study.categories)})."


def source(name: str) -> str:
    """The name of a component in a table."""
    return "part to part" if name == "part" else name


def chart_titles() -> tuple[str, ...]:
    """The titles of the six charts of a quantity, row by row."""
    return (
        "Components of variation",
        "Part by tester",
        "sd of the repeats",
        "Measurements by part",
        "Means of the parts",
        "Measurements by tester",
    )


def figure_words(study: GaugeStudy) -> str:
    """Alternative text of the charts of a quantity."""
    return f"{label(study.quantity)}: components of variation, repeats and means by part and tester"


def axis_label(study: GaugeStudy) -> str:
    """Label of an axis that shows the quantity."""
    unit = UNITS.get(study.quantity, "")
    return f"{label(study.quantity)}{f' [{unit}]' if unit else ''}"


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


def estimate_verdict(study: GaugeStudy) -> str:
    """AIAG's verdict by the estimate of % study variation alone."""
    return _verdict_of(study.component("GRR").study.value)


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
