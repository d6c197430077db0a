"""Sentences about nights that are compared."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from .limits import origin_sentence as origin_sentence
from .numbers import number, rounded
from .quantities import UNITS, label, percent

if TYPE_CHECKING:
    from ..trend.content import Alarm, TrendChart, TrendContent
    from ..trend.difference import Comparison, Difference
    from ..trend.rules import RunRule

_YIELD = "yield"
_NAMES = {
    _YIELD: "yield",
    "split_cos2theta_hz": "split · cos 2θ",
    "split_sin2theta_hz": "split · sin 2θ",
}
_UNITS = {_YIELD: "%", "split_cos2theta_hz": "Hz", "split_sin2theta_hz": "Hz"}
GROUPS = {
    "limits": "Limits and rule",
    "population": "Population",
    "experiment": "Experiment",
    "configuration": "Configuration",
    "file": "Files",
    "version": "Versions",
}


def name_words(name: str) -> str:
    """A chart in words."""
    return _NAMES.get(name, label(name))


def axis_label(name: str, unit: str) -> str:
    """A chart in words with the unit of its values; means are those of a night."""
    shown = _UNITS.get(name, "" if unit == "1" else unit)
    words = name_words(name) if name == _YIELD else f"mean {name_words(name)}"
    return f"{words[0].upper()}{words[1:]}{f', {shown}' if shown else ''}"


def night_label(created: str) -> str:
    """Day and time of a night, "11-23 04:10", from its ISO time."""
    return created[5:16].replace("T", " ")


def value_words(name: str, value: float, spread: float) -> str:
    """A value with decimals that suit ``spread``, and its unit; a yield in percent."""
    if not math.isfinite(value):
        return "–"
    if name == _YIELD:
        return percent(value)
    unit = _UNITS.get(name, UNITS.get(name, ""))
    text = rounded(value, spread) if math.isfinite(spread) and spread > 0.0 else number(value, 6)
    return f"{text} {unit}".strip().replace("-", "−")


def range_words(name: str, low: float, high: float, spread: float) -> str:
    """ "529.1 to 541.0 Hz", "at least 50 %", "at most 3 Hz"."""
    if math.isinf(low) or math.isinf(high):
        ends = ("at most", high) if math.isinf(low) else ("at least", low)
        return f"{ends[0]} {value_words(name, ends[1], spread)}"
    first = value_words(name, low, spread).rpartition(" ")
    return f"{first[0] or first[2]} to {value_words(name, high, spread)}"


def difference_words(row: Difference) -> str:
    """The difference with its 95 % interval, in points where it is a yield."""
    spread = (row.high - row.low) / 4.0
    if row.name == _YIELD:
        found, low, high = (100.0 * one for one in (row.difference, row.low, row.high))
        text = f"{found:+.1f}"
        return (f"{text} points ({low:+.1f} to {high:+.1f})" if math.isfinite(low) else f"{text} points").replace(
            "-", "−"
        )
    value = value_words(row.name, row.difference, spread)
    sign = "+" if row.difference > 0.0 else ""
    if not math.isfinite(row.low):
        return f"{sign}{value}"
    return f"{sign}{value} ({range_words(row.name, row.low, row.high, spread)})"


def alarm_words(alarm: Alarm) -> str:
    """One alarm in a sentence."""
    spread = (alarm.high - alarm.low) / 50.0 if math.isfinite(alarm.high - alarm.low) else 0.0
    value = value_words(alarm.name, alarm.value, spread)
    allowed = range_words(alarm.name, alarm.low, alarm.high, spread)
    if alarm.rule == "limit":
        return f"{_started(alarm.name)} {value} is beyond the limit that was set: {allowed}."
    if alarm.rule == "1 of 1":
        return f"{_started(alarm.name)} {value} is beyond the limits of one night, {allowed}."
    count, _, last = alarm.rule.partition(" of ")
    return f"{_started(alarm.name)} {value}: {count} of the last {last} nights lie far on the same side of the mean."


def _started(name: str) -> str:
    words = name_words(name) if name == _YIELD else f"mean {name_words(name)}"
    return f"{words[0].upper()}{words[1:]}"


def headline(content: TrendContent) -> str:
    """The verdict on a night, in a few words."""
    found = sorted({name_words(alarm.name) for alarm in (*content.alarms, *content.broken_limits)})
    if found:
        return f"Alarm: {', '.join(found)}"
    moved = [] if content.comparison is None else [row.name for row in content.comparison.differences if row.differs]
    if moved:
        return f"Different: {', '.join(map(name_words, moved))}"
    if not content.charts:
        return "No difference found" if content.comparison is not None else "Nothing to compare with"
    if not any(math.isfinite(chart.tonight.q) for chart in content.charts if chart.points):
        return "Too few nights to judge"
    return "In control"


def judged_words(content: TrendContent) -> str:
    """How many nights judge this one, and how sure an alarm is."""
    if not content.charts:
        return ""
    nights = len(content.nights) - 1
    if nights < 2:
        found = _count(nights, "earlier night")
        return f"{found} can be compared. Control limits need at least two; useful ones need eight or more."
    return (
        f"Judged by {_count(nights, 'earlier night')}. A night in control raises any alarm on these {len(content.charts)} charts "
        f"with a probability of {percent(content.false_alarm)}, at most."
    )


def comparison_words(comparison: Comparison) -> str:
    """How the two runs were compared."""
    if comparison.paired:
        how = "Both runs hold the same devices, so each device is compared with itself"
    elif comparison.by == "device":
        how = "Lots and wafers are unknown or too few, so single devices are taken as independent draws"
    else:
        how = (
            f"{comparison.by.capitalize()}s are the independent draws of the process "
            f"({comparison.groups[0]} before, {comparison.groups[1]} in this run)"
        )
        if comparison.by == "wafer":
            how += "; the scatter between lots is not included"
    return (
        f"{how}. Intervals hold at 95 % for each row alone; the last column counts all rows together (Holm): the probability of "
        "any false “differs” is at most 5 %."
    )


def rules_words(chart: TrendChart) -> str:
    """The rules that judge the last night, with their limits."""
    return "; ".join(_rule_words(rule) for rule in chart.rules)


def _rule_words(rule: RunRule) -> str:
    place = f"beyond {rule.limit:.2f} sd on the same side"
    return f"1 night beyond {rule.limit:.2f} sd" if rule.n == 1 else f"{rule.k} of the last {rule.n} nights {place}"


def terminal(content: TrendContent) -> str:
    """The answer as text."""
    lines = [f"{headline(content)}: run {content.run_id}"]
    lines += [alarm_words(alarm) for alarm in (*content.alarms, *content.broken_limits)]
    if content.charts:
        lines.append(judged_words(content))
    if content.comparison is not None:
        lines.append(f"against {content.comparison.before}:")
        rows = [
            (name_words(row.name), _both(row), difference_words(row), "differs" if row.differs else "")
            for row in content.comparison.differences
        ]
        widths = [max(len(row[k]) for row in rows) for k in range(3)]
        lines += [f"  {a:{widths[0]}}  {b:{widths[1]}}  {c:{widths[2]}}  {d}".rstrip() for a, b, c, d in rows]
    lines += [f"changed: {one.key}: {one.before} -> {one.after}" for one in content.changes]
    lines += [
        f"left out{f' of {_listed(one.charts)}' if one.charts else ''}: {one.run_id}: {one.reason}"
        for one in content.left_out
    ]
    return _plain("\n".join(lines))


def alarm_count(alarms: Sequence[Alarm]) -> str:
    """The first of the alarms in a clause, and how many there are."""
    more = f", and {len(alarms) - 1} more" if len(alarms) > 1 else ""
    return _plain(f"alarm: {alarm_words(alarms[0])[:-1]}{more}")


def _plain(text: str) -> str:
    """For a terminal, where a space that does not break would be escaped."""
    return text.replace("\u00a0", " ")


def _both(row: Difference) -> str:
    spread = (row.high - row.low) / 4.0
    return f"{value_words(row.name, row.before, spread)} -> {value_words(row.name, row.after, spread)}"


def _listed(names: Sequence[str]) -> str:
    return ", ".join(map(name_words, names))


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"
