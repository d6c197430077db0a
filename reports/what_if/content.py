"""The content of a what-if page: the run by its own limits and by new ones; frozen data, no HTML, no figures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from ..capability import Capability, Common, capabilities
from ..clusters import Clustering, clustering
from ..common_errors import GivenCommon, clustering_with_common, given_common, groups_with_common, with_common
from ..decision_risk import DecisionRisk, decision_risks
from ..devices import ColumnSource, Devices
from ..limits import Limit, Limits
from ..yields import GroupYield, Interval, Yield, by_group, yield_of_verdicts
from .changes import ChangedDevice, LimitChange, by_limit, changed_devices, difference, transitions
from .costs import LimitCurve, PairLoss, limit_curves, pair_losses
from .judge import Again


@dataclass(frozen=True)
class YieldPair:
    """The yield of a lot, a wafer or all devices by the old limits and by the new ones; empty names for all."""

    lot: str
    wafer: str
    old: Yield
    new: Yield


@dataclass(frozen=True)
class Thinning:
    """What the stored draws cost.

    Parameters
    ----------
    stored, of : draws of a device that are stored, and that the run had.
    doubtful : devices whose verdict could be another with all draws: P(conform) within 2 sd of a threshold.
    disagree : devices that the stored draws alone would judge otherwise than the run, by the old limits.
    normal : quantities that were drawn from a normal distribution with estimate and sd instead.
    """

    stored: int
    of: int
    doubtful: int
    disagree: int
    normal: tuple[str, ...]


@dataclass(frozen=True)
class WhatIf:
    """All content of the page, in its order."""

    run_id: str
    old: Limits
    new: Limits
    limits_name: str
    total: YieldPair
    difference: Interval
    changed: tuple[ChangedDevice, ...]
    transitions: tuple[tuple[str, str, int], ...]
    changes: tuple[LimitChange, ...]
    lots: tuple[YieldPair, ...]
    wafers: tuple[YieldPair, ...]
    clusters: tuple[tuple[Clustering, Clustering], ...]
    curves: tuple[LimitCurve, ...]
    singles: tuple[tuple[Limit, int], ...]
    pairs: tuple[PairLoss, ...]
    risks_old: tuple[DecisionRisk, ...]
    risks_new: tuple[DecisionRisk, ...]
    capabilities: tuple[Capability, ...]
    thinning: Thinning | None
    statuses: tuple[tuple[str, int, int], ...]


def what_if(
    run_id: str,
    devices: Devices,
    after: Devices,
    posterior: ColumnSource | None,
    given: GivenCommon | None,
    again: Again,
    old: Limits,
    new: Limits,
    thinning: tuple[int, int, tuple[str, ...]] | None,
    limits_name: str = "",
    common: Common = MappingProxyType({}),
) -> WhatIf:
    """The content of a what-if page.

    Parameters
    ----------
    devices, after : the devices table by the old limits and by the new ones.
    posterior, given : the draws of the run, and P(conform to the new limits) at each common error (``None``: no common errors).
    again : the new verdicts.
    old, new : the limits.
    thinning : stored draws, draws of the run, quantities drawn from a normal distribution; ``None`` where no draws are needed.
    limits_name : name of the file of the new limits.
    common : quantity -> (E, B) shift by one sd of each error that all devices share.
    """
    before_given = given_common(devices, posterior, old.rule)
    verdicts = devices.text("verdict"), after.text("verdict")
    lots, wafers = devices.text("lot"), devices.text("wafer")
    named = devices.wafers()
    changed = changed_devices(devices, after, again)
    totals = [with_common(yield_of_verdicts(v), g) for v, g in zip(verdicts, (before_given, given), strict=True)]
    groups = [
        (
            groups_with_common(by_group(v, lots), lots, None, g),
            groups_with_common(by_group(v, lots, wafers), lots, wafers, g),
        )
        for v, g in zip(verdicts, (before_given, given), strict=True)
    ]
    clusters = [
        [
            clustering_with_common(clustering(v, names, by), names, g)
            for by, names in (("wafer", named), ("lot", lots))
            if len(names) and all(names.counts())
        ]
        for v, g in zip(verdicts, (before_given, given), strict=True)
    ]
    return WhatIf(
        run_id,
        old,
        new,
        limits_name,
        YieldPair("", "", *totals),
        difference(verdicts[0].equals("pass"), verdicts[1].equals("pass"), named),
        changed,
        transitions(*verdicts),
        by_limit(changed, new, old),
        _pairs_of_groups(groups[0][0], groups[1][0]) if any(lots.counts()) else (),
        _pairs_of_groups(groups[0][1], groups[1][1]) if any(wafers.counts()) else (),
        tuple(zip(*clusters, strict=True)),
        limit_curves(devices, again, old, totals[1]),
        tuple((limit, int(again.without[1 + k] - again.without[0])) for k, limit in enumerate(new.limits)),
        pair_losses(again, new, len(devices)),
        decision_risks(devices, old, common),
        decision_risks(after, new, common),
        capabilities(after, new, common),
        None if thinning is None else _thinning(devices, again, old, new, thinning),
        _statuses(devices, again),
    )


def _pairs_of_groups(old: Sequence[GroupYield], new: Sequence[GroupYield]) -> tuple[YieldPair, ...]:
    return tuple(YieldPair(a.lot, a.wafer, a.result, b.result) for a, b in zip(old, new, strict=True))


def _thinning(
    devices: Devices, again: Again, old: Limits, new: Limits, counts: tuple[int, int, tuple[str, ...]]
) -> Thinning:
    stored, of, normal = counts
    doubtful = np.zeros(len(devices), dtype=np.bool_)
    for at in (new.rule.pass_at, new.rule.fail_at):
        doubtful |= np.abs(again.p_pass - at) < 2.0 * again.p_pass_sd
    share, ok = again.stored_old, devices.is_ok() & np.isfinite(again.stored_old)
    by_stored = np.where(share >= old.rule.pass_at, 1, np.where(share <= old.rule.fail_at, 2, 0))
    by_run = np.where(devices.has("pass"), 1, np.where(devices.has("fail"), 2, 0))
    disagree = 0 if old.rule.by_estimate else int(np.sum(ok & (by_stored != by_run)))
    return Thinning(stored, of, 0 if new.rule.by_estimate else int(doubtful.sum()), disagree, normal)


def _statuses(devices: Devices, again: Again) -> tuple[tuple[str, int, int], ...]:
    """Devices by status, by the old gate and by the new one."""
    before, now = devices.text("status").counts(), again.status.counts()
    names = dict.fromkeys((*before, *now))
    return tuple((name, before.get(name, 0), now.get(name, 0)) for name in names if before.get(name) or now.get(name))
