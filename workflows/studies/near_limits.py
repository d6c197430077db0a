"""Wrong decisions of a sequential rule against the distance of a device from a limit.

A limit is put at a distance of x final sd above and below the true value of each limited quantity of a device, one limit at a
time, and each rule judges the same analyses against it:

    final sd   posterior sd of the quantity at the end of the record
    wrong      "fail" although the truth is inside the limit; a "pass" of a limit on the other side is the same event

The verdicts about one device share its noise, so intervals treat devices, not verdicts, as independent draws.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, Literal

import numpy as np

from pipeline.arrays import FloatArray
from reports.clusters import effective_number
from reports.decision import Verdict
from reports.limits import Limit, Limits
from reports.sequential import INDIFFERENCE_SD, checked
from reports.yields import clopper_pearson

SEQUENTIAL, ALONE = "sequential", "P(conform) alone"
#: Distances from the limit [final sd]: within the indifference zone, at its edge, and where early analyses decide.
DISTANCES: tuple[float, ...] = (0.5, 1.0, 2.0, 3.0, 4.0, 8.0, 16.0, 64.0, 256.0)


@dataclass(frozen=True)
class NearVerdicts:
    """One rule, distance [final sd], quantity and device: wrong, decided and all verdicts, and their times [s]."""

    rule: str
    distance: float
    quantity: str
    wrong: int
    decided: int
    total: int
    times_s: tuple[float, ...]


@dataclass(frozen=True)
class DeviceShare:
    """count of total verdicts, with the 95 % interval for devices as independent draws (Korn and Graubard)."""

    count: int
    total: int
    devices: int
    interval: tuple[float, float]

    def __str__(self) -> str:
        low, high = self.interval
        share = 100.0 * self.count / max(self.total, 1)
        return f"{share:.1f} % ({self.count}/{self.total}, {self.devices} devices, {100 * low:.1f} to {100 * high:.1f})"


def near_verdicts(
    limits: Limits,
    truth: Mapping[str, FloatArray],
    analyses: Sequence[Mapping[str, FloatArray] | None],
    times_s: Sequence[float],
) -> tuple[NearVerdicts, ...]:
    """Verdicts about limits near the truth of one device; none if its last analysis has no draws.

    Parameters
    ----------
    limits : rule and limited quantities; their values are replaced.
    truth : quantity -> true value.
    analyses : draws (n,) by quantity at each analysis; ``None`` without an estimate.
    times_s : time of each analysis [s]; the last is the end of the record.
    """
    last = analyses[-1]
    if last is None:
        return ()
    known = [q for limit in limits.limits if not limit.axis and np.isfinite(truth[q := limit.quantity])]
    out = []
    for distance, name in product(DISTANCES, known):
        sides = []
        for side in (1.0, -1.0):
            end = side * (float(truth[name]) + side * distance * float(np.std(last[name])))
            # Values below the limit conform; a lower limit is the upper limit of the negative quantity.
            signed = [None if draws is None else side * draws[name] for draws in analyses]
            sides.append(_first(Limits(limits.rule, (Limit(name, -np.inf, end),)), signed, times_s))
        out += [_counted(rule, distance, name, [side[rule] for side in sides]) for rule in (SEQUENTIAL, ALONE)]
    return tuple(out)


def _counted(rule: str, distance: float, name: str, found: Sequence[tuple[Verdict, float]]) -> NearVerdicts:
    wrong = sum(verdict == "fail" for verdict, _ in found)
    decided = sum(verdict != "undecided" for verdict, _ in found)
    return NearVerdicts(rule, distance, name, wrong, decided, len(found), tuple(time for _, time in found))


def _first(
    limits: Limits, analyses: Sequence[FloatArray | None], times_s: Sequence[float]
) -> dict[str, tuple[Verdict, float]]:
    """The first verdict of each rule about one upper limit, and its time [s]."""
    end = limits.limits[0].high
    out: dict[str, tuple[Verdict, float]] = {}
    for k, (draws, time_s) in enumerate(zip(analyses, times_s), start=1):
        last = k == len(times_s)
        alone: Verdict = "undecided"
        verdict: Verdict = "undecided"
        if draws is not None:
            p = float(np.mean(draws <= end))
            alone = "pass" if p >= limits.rule.pass_at else "fail" if p <= limits.rule.fail_at else "undecided"
            verdict = checked(limits, alone, (end - float(np.mean(draws))) / float(np.std(draws)), k, last)
        for rule, now in ((SEQUENTIAL, verdict), (ALONE, alone)):
            if rule not in out and (now != "undecided" or last):
                out[rule] = (now, time_s)
    return out


def near_figures(devices: Sequence[Sequence[NearVerdicts]]) -> dict[str, Any]:
    """Wrong and decided shares and median time at each distance, and wrong shares of each quantity at the guarantee, by name."""
    out: dict[str, Any] = {}
    for rule, distance in product((SEQUENTIAL, ALONE), DISTANCES):
        rows = [[row for row in device if (row.rule, row.distance) == (rule, distance)] for device in devices]
        where = f"{rule}, {distance:g} final sd from a limit"
        out[f"{where}: wrong"] = _share(rows, "wrong")
        out[f"{where}: decided"] = _share(rows, "decided")
        times = [row.times_s for device in rows for row in device]
        out[f"{where}: median time, s"] = float(np.median(np.concatenate(times))) if times else float("nan")
    for name in dict.fromkeys(row.quantity for device in devices for row in device):
        key = (SEQUENTIAL, INDIFFERENCE_SD, name)
        rows = [[row for row in device if (row.rule, row.distance, row.quantity) == key] for device in devices]
        out[f"{SEQUENTIAL}, {INDIFFERENCE_SD:g} final sd from a limit of {name}: wrong"] = _share(rows, "wrong")
    return out


def _share(rows: Sequence[Sequence[NearVerdicts]], which: Literal["wrong", "decided"]) -> DeviceShare:
    """The share of verdicts; ``rows`` holds those of one device in each element."""
    count = [sum(getattr(row, which) for row in device) for device in rows]
    total = [sum(row.total for row in device) for device in rows]
    all_count, all_total, devices = sum(count), sum(total), len(total)
    if devices < 2 or all_count in (0, all_total):
        # All verdicts agree: one device then says at most as much as one verdict.
        interval = clopper_pearson(devices * all_count / max(all_total, 1), devices)
    else:
        flags = np.concatenate([np.arange(n) < k for k, n in zip(count, total)]).astype(np.float64)
        found = effective_number(flags, np.repeat(np.arange(devices), total), devices)
        interval = clopper_pearson(found.share * found.effective, found.effective)
    return DeviceShare(all_count, all_total, devices, (interval.low, interval.high))
