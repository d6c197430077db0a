"""Causes of loss: the failed limits, and the losses in fabrication and in packaging.

Counts are devices.  "Failed" are the devices whose verdict is "fail"; the stages compare the virtual truth
as fabricated (fab_) and as packaged (true_) with the limits, whatever the verdict.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np

from pipeline.arrays import BoolArray

from ..devices import Devices
from ..limits import Limit, Limits
from ..yields import Interval, clopper_pearson


@dataclass(frozen=True)
class FailedLimit:
    """One bar of the Pareto.

    Parameters
    ----------
    limit : the limit.
    failed : failed devices that break it.
    alone : those that break no other.
    share : Clopper-Pearson interval of failed / all failed devices.
    below, above : number of estimates on each side (both 0 for an axis, which has no sides).
    """

    limit: Limit
    failed: int
    alone: int
    share: Interval
    below: int
    above: int


@dataclass(frozen=True)
class Pareto:
    """Failed limits, most frequent first; ``jointly`` devices fail although no single limit is improbable."""

    failed: int
    limits: tuple[FailedLimit, ...]
    jointly: int


@dataclass(frozen=True)
class StageLoss:
    """Truth against one limit (``None``: all together), as fabricated and as packaged.

    Parameters
    ----------
    both : conform at both stages.
    packaging : conform as fabricated, not as packaged: lost in packaging.
    recovered : the opposite: conform as packaged only.
    fabrication : conform at neither: lost in fabrication.
    unknown : truth of a stage is not known.
    """

    limit: Limit | None
    both: int
    packaging: int
    recovered: int
    fabrication: int
    unknown: int


def pareto(devices: Devices, limits: Limits) -> Pareto:
    """How often each limit fails among the failed devices."""
    fails = devices.has("fail")
    cells = devices.text("failed_limits")
    broken = [tuple(filter(None, names.split(","))) for names in cells.words]
    number = [int(n) for n in np.bincount(cells.codes[fails], minlength=len(broken))]
    total = sum(number)
    count, alone = Counter[str](), Counter[str]()
    for names, n in zip(broken, number, strict=True):
        count.update(dict.fromkeys(names, n))
        alone.update({names[0]: n} if len(names) == 1 else {})
    rows = []
    for limit in limits.limits:
        breaks = fails & cells.each([limit.quantity in names for names in broken])
        values = devices.number(limit.quantity)[breaks]
        k = count[limit.quantity]
        rows.append(
            FailedLimit(
                limit=limit,
                failed=k,
                alone=alone[limit.quantity],
                share=clopper_pearson(k, total),
                below=0 if limit.axis else int(np.sum(values < limit.low)),
                above=0 if limit.axis else int(np.sum(values > limit.high)),
            )
        )
    rows.sort(key=lambda row: (-row.failed, -row.alone))
    return Pareto(total, tuple(rows), sum(n for names, n in zip(broken, number, strict=True) if not names))


def stage_losses(devices: Devices, limits: Limits) -> tuple[StageLoss, ...]:
    """All limits together first, then each; empty if no device has a truth at both stages."""
    rows = []
    known_all = np.ones(len(devices), dtype=np.bool_)
    fab_all, true_all = known_all.copy(), known_all.copy()
    for limit in limits.limits:
        fab, true = devices.truth(limit, "fab"), devices.truth(limit)
        known = fab.finite & true.finite
        rows.append(_stages(limit, fab.conforms, true.conforms, known))
        known_all &= known
        fab_all &= fab.conforms
        true_all &= true.conforms
    if not any(row.unknown < len(devices) for row in rows):
        return ()
    return (_stages(None, fab_all, true_all, known_all), *rows)


def _stages(limit: Limit | None, fab: BoolArray, true: BoolArray, known: BoolArray) -> StageLoss:
    return StageLoss(
        limit,
        both=int(np.sum(known & fab & true)),
        packaging=int(np.sum(known & fab & ~true)),
        recovered=int(np.sum(known & ~fab & true)),
        fabrication=int(np.sum(known & ~fab & ~true)),
        unknown=int(np.sum(~known)),
    )
