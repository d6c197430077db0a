"""Study of the trend: how often do nights in control raise an alarm, and how large a shift is found?

    normal       charts of independent or correlated normal nights, from the formulas alone
    population   nights drawn from the default population: lots, wafers and dies differ, values are not normal, yields are counts;
                 a row is one series of nights that ends with a comparison of its last two

    DIR/population.jsonl    one JSON object per row; an interrupted study continues there

A row depends on (seed, number) only.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.arrays import FloatArray
from populations.draw import draw
from reports.decision import conforms
from reports.limits import DEFAULT_LIMITS
from reports.trend.chart import BEFORE, q_statistics, share_of
from reports.trend.charted import COMPONENTS
from reports.trend.content import chart_alarms, charts_of
from reports.trend.difference import compared
from reports.trend.night import Grouping, Night
from reports.trend.rules import alarms, calibrated

from ..config import load_config
from ..screening.block import true_quantities
from ..screening.settings import population
from .coverage import Share
from .rows_by_kind import add_rows

KIND = "population"
RATES = (0.01, 0.05)
#: Earlier nights of a chart of normal values, and the shifts of the last night [sd between nights].
NIGHTS, SHIFTS = (2, 3, 5, 10, 20, 50), (2.0, 3.0, 4.0, 6.0)
CHARTS, CORRELATION = 10, 0.7
#: Earlier nights and devices of a night of a row.
EARLIER, DEVICES = 10, 50
_NAMES = (*DEFAULT_LIMITS.quantities, *COMPONENTS)
_STREAM = 141


def study_row(seed: int, item: tuple[str, int]) -> dict[str, Any]:
    """The row of ``item`` = (kind, number), computed on a worker."""
    kind, number = item
    started = time.process_time()
    nights = [_night(seed, number, k) for k in range(EARLIER + 1)]
    comparison = compared(nights[-2], nights[-1], _NAMES, False)
    return {
        "kind": kind,
        "number": number,
        "seed": seed,
        "alarms": {str(rate): _alarmed(nights, rate) for rate in RATES},
        "within": _alarmed_within(nights),
        "differs": [row.name for row in comparison.differences if row.differs],
        "covered": {row.name: row.low <= 0.0 <= row.high for row in comparison.differences},
        "cpu_seconds": time.process_time() - started,
    }


def _night(seed: int, number: int, k: int) -> Night:
    """A night of virtual devices, with true values in the place of estimates: the error of a measurement is much smaller."""
    config = load_config(None)
    spec = population(config)
    own = int(np.random.SeedSequence(seed, spawn_key=(_STREAM, number, k)).generate_state(1)[0])
    drawn = draw(spec, own, 0, DEVICES)
    true = true_quantities(config, drawn.true, float(spec.angular_gain))
    twice = np.radians(2.0 * true["theta_deg"])
    true |= {COMPONENTS[0]: true["split_hz"] * np.cos(twice), COMPONENTS[1]: true["split_hz"] * np.sin(twice)}
    lots = np.unique(drawn.lot, return_inverse=True)[1].astype(np.int64)
    values = {name: true[name] for name in _NAMES}
    return Night(f"{number}-{k}", "", drawn.device_id, conforms(DEFAULT_LIMITS, true), values, Grouping("lot", lots))


def _alarmed(nights: Sequence[Night], rate: float) -> list[str]:
    charts = charts_of([night.summary(_NAMES) for night in nights], _NAMES, rate, [True] * len(nights))
    return sorted({alarm.name for alarm in chart_alarms(charts, nights[-1].run_id)})


def _alarmed_within(nights: Sequence[Night]) -> list[str]:
    """What 3 sd of the scatter of devices within a night would alarm at: the chart of subgroups that this one replaces."""
    found = []
    for name in _NAMES:
        means = np.array([night.values[name].mean() for night in nights])
        variance = np.mean([night.values[name].var(ddof=1) / night.devices for night in nights[:-1]])
        if abs(means[-1] - means[:-1].mean()) > 3.0 * np.sqrt(variance * (1.0 + 1.0 / EARLIER)):
            found.append(name)
    return found


def run_study(count: int, seed: int, folder: Path, workers: int) -> Iterator[tuple[int, int]]:
    """Add the missing rows to the file in ``folder``; yields (done, total); UsageError if it cannot be written."""
    return add_rows(study_row, (KIND,), (KIND,), count, seed, folder, workers)


def normal_alarms(
    series: int, nights: int, rate: float, seed: int, correlation: float = 0.0, shift: float = 0.0
) -> Share:
    """Series of ``nights`` earlier normal nights and one more, on ``CHARTS`` charts, whose last night alarms.

    Parameters
    ----------
    correlation : of the charts; ``shift``: of the last night on the first chart [sd between nights].
    """
    random = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_STREAM, nights, round(1e3 * shift))))
    own = random.standard_normal((series, CHARTS, nights + 1))
    common = random.standard_normal((series, 1, nights + 1))
    values: FloatArray = np.sqrt(1.0 - correlation) * own + np.sqrt(correlation) * common
    values[:, 0, -1] += shift
    q = q_statistics(values)[..., BEFORE:]
    rules = calibrated(share_of(rate, CHARTS), nights + 1 - BEFORE)
    return Share(int(alarms(q, rules).any(axis=(1, 2)).sum()), series)


def figures(rows: Sequence[Mapping[str, Any]], series: int, seed: int) -> dict[str, Any]:
    """Rates of false alarms and of found shifts, with intervals."""
    found: dict[str, Any] = {}
    for rate in RATES:
        for nights in NIGHTS:
            found[f"normal, {nights} earlier nights, false alarms at {rate:g}"] = normal_alarms(
                series, nights, rate, seed
            )
        found[f"normal, correlation {CORRELATION:g}, 10 earlier nights, false alarms at {rate:g}"] = normal_alarms(
            series, 10, rate, seed, CORRELATION
        )
    for nights in (5, 20):
        for shift in SHIFTS:
            name = f"one chart of {CHARTS} shifted by {shift:g} sd, {nights} earlier nights, alarms at {RATES[0]:g}"
            found[name] = normal_alarms(series, nights, RATES[0], seed, shift=shift)
    for rate in RATES:
        raised = [row["alarms"][str(rate)] for row in rows]
        found[f"population, {EARLIER} earlier nights, false alarms at {rate:g}"] = Share(
            sum(map(bool, raised)), len(rows)
        )
        of_yield = sum("yield" in names for names in raised)
        found[f"of these on the yield (its share is {share_of(rate, len(_NAMES) + 1):.2g})"] = Share(
            of_yield, len(rows)
        )
    found["population, alarms at 3 sd of the scatter within a night"] = Share(
        sum(bool(r["within"]) for r in rows), len(rows)
    )
    found["population, two nights, any false difference (family-wise 5 %)"] = Share(
        sum(bool(row["differs"]) for row in rows), len(rows)
    )
    for name in ("yield", "f1_hz", "split_hz", "quality1"):
        covered = sum(bool(row["covered"][name]) for row in rows)
        found[f"population, two nights, 95 % intervals that hold, {name}"] = Share(covered, len(rows))
    return found
