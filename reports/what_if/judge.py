"""All devices of a run judged again by new limits: verdicts, curves of the yield, losses to single limits and pairs.

Shapes: B devices, E ends of limits, G positions, L limits, W wafers.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.arrays import BoolArray, FloatArray

from ..acceptance import by_estimates
from ..coded import CodedText, IntArray
from ..devices import Devices
from ..limits import Limits
from .draws import DrawBatch, EndGrid, LimitEnd, ends_of, pairs_of, passes, reweighted
from .estimates import Estimates, curves, p_inside, without

#: Positions of an end of a limit in its curve.
POSITIONS = 61
_VERDICTS = ("undecided", "pass", "fail")


@dataclass(frozen=True, eq=False)
class Again:
    """What the new limits say.

    Parameters
    ----------
    status : B statuses by the gate of the new limits.
    verdict, failed_limits : B texts.
    p_pass, p_pass_sd : (B,) P(conform) and its Monte Carlo sd; nan where it is unknown.
    stored_old : (B,) share of the stored draws that meets the old limits; nan without draws.
    own_old, own_new : quantity -> (B,) probability that each limit is met, of a normal distribution.
    grids : the ends of the limits and their positions.
    passed : (E, G, W) devices that pass with an end moved, by wafer.
    without : (1 + L + pairs,) devices that pass without no limit, without each, and without each pair.
    """

    status: CodedText
    verdict: CodedText
    failed_limits: CodedText
    p_pass: FloatArray
    p_pass_sd: FloatArray
    stored_old: FloatArray
    own_old: dict[str, FloatArray]
    own_new: dict[str, FloatArray]
    grids: tuple[EndGrid, ...]
    passed: IntArray
    without: IntArray


def judge_again(
    devices: Devices, old: Limits, new: Limits, status: CodedText, batches: Iterable[DrawBatch], wafer: CodedText
) -> Again:
    """Judge all devices by ``new``.

    Parameters
    ----------
    devices : the devices of the run, with the verdicts by ``old``.
    old, new : limits of the run and new limits.
    status : B statuses by the gate of the new limits: only "ok" is judged.
    batches : stored draws of devices with the status "ok", each device at most once; none where they are absent.
    wafer : B names of wafers, or of other groups.
    """
    rows = len(devices)
    judged = status.equals("ok")
    found = _estimates(devices, (*old.quantities, *new.quantities))
    grids = tuple(_grid(end, old, found, judged) for end in ends_of(*new.limits))
    p_run = devices.number("p_pass")
    p_pass, sd, stored = (np.full(rows, np.nan) for _ in range(3))
    surely, maybe = np.zeros(rows), np.ones(rows)
    own = np.full((len(new.limits), rows), np.nan)
    groups = max(len(wafer.words), 1)
    passed = np.zeros((len(grids), POSITIONS, groups), dtype=np.int64)
    alone = np.zeros(1 + len(new.limits) + len(pairs_of(len(new.limits))), dtype=np.int64)
    for batch in batches:
        part, rows_of = reweighted(batch, p_run[batch.rows], old, new), batch.rows
        p_pass[rows_of], sd[rows_of], stored[rows_of] = part.p_pass, part.sd, part.stored_old
        surely[rows_of], maybe[rows_of], own[:, rows_of] = part.surely, part.maybe, part.own
        if not new.rule.by_estimate:
            further = passes(batch, part, grids, new.rule.pass_at)
            passed += _by_group(further.curves, wafer.codes[rows_of], groups)
            alone += further.without.sum(axis=1)
    inside_new = p_inside(new, found)
    if new.rule.by_estimate:
        held = Estimates(*({k: v[judged] for k, v in one.items()} for one in (found.value, found.u)))
        passed = _by_group(curves(new, held, grids), wafer.codes[judged], groups)
        alone = without(new, held).sum(axis=1)
        ruled = by_estimates(new.rule, new.limits, found.value, found.u)
        passing, failing = ruled.passes, ruled.fails
        rank = -np.array(list(ruled.outside.values()))
        # Without draws, P(conform) is that of independent normal quantities: it serves the risks, not the verdict.
        p_pass = np.where(np.isnan(p_pass) & judged, inside_new.prod(axis=0), p_pass)
    else:
        passing, failing = surely >= new.rule.pass_at, maybe <= new.rule.fail_at
        rank = np.where(own <= 0.5, own - 1.0, 0.0)
    verdict = np.where(judged & passing, 1, np.where(judged & failing, 2, 0)).astype(np.int64)
    return Again(
        status,
        CodedText(_VERDICTS, verdict),
        _failed(new.quantities, np.where(judged, rank, 0.0)),
        np.where(judged, p_pass, np.nan),
        np.where(judged, sd, np.nan),
        stored,
        dict(zip(old.quantities, p_inside(old, found), strict=True)),
        dict(zip(new.quantities, inside_new, strict=True)),
        grids,
        passed,
        alone,
    )


def _estimates(devices: Devices, names: Sequence[str]) -> Estimates:
    known = tuple(dict.fromkeys(names))
    return Estimates({q: devices.number(q) for q in known}, {q: devices.number(f"{q}_sd") for q in known})


def _grid(end: LimitEnd, old: Limits, found: Estimates, judged: BoolArray) -> EndGrid:
    """Positions over the central 98 % of the estimates and both ends, with a twentieth beyond."""
    x = end.coordinate(found.value[end.limit.quantity][judged])
    x = x[np.isfinite(x)]
    same = [one for one in old.limits if one.quantity == end.limit.quantity]
    before = [float(end.coordinate(np.array(one.high if end.high else one.low))) for one in same]
    marks = [end.at, *(at for at in before if np.isfinite(at)), *(np.quantile(x, [0.01, 0.99]) if x.size else ())]
    low, high = float(min(marks)), float(max(marks))
    room = 0.05 * (high - low) or 0.05 * abs(high) or 1.0
    return EndGrid(end, np.linspace(low - room, high + room, POSITIONS))


def _by_group(passing: BoolArray, group: IntArray, groups: int) -> IntArray:
    """(E, G, W) devices that pass, by group; ``passing`` (E, G, b)."""
    order = np.argsort(group, kind="stable")
    present, start = np.unique(group[order], return_index=True)
    out = np.zeros((*passing.shape[:2], groups), dtype=np.int64)
    if present.size:
        out[:, :, present] = np.add.reduceat(passing[:, :, order].astype(np.int32), start, axis=2)
    return out


def _failed(names: Sequence[str], rank: FloatArray) -> CodedText:
    """B lists of the names with negative ``rank`` (L, B), the lowest first; few different lists, so each is written once."""
    order = np.argsort(rank, axis=0, kind="stable")
    bad = np.take_along_axis(rank, order, axis=0) < 0.0
    code = np.where(bad, order + 1, 0)
    lists, index = np.unique(code, axis=1, return_inverse=True)
    words = [",".join(names[k - 1] for k in column if k) for column in lists.T]
    return CodedText(tuple(words), index.reshape(-1).astype(np.int64))
