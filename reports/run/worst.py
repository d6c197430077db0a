"""The devices to look at first: not identified, undecided, and farthest from conforming."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pipeline.arrays import BoolArray, FloatArray

from ..coded import IntArray
from ..devices import Devices, rows_of
from ..limits import Limits


@dataclass(frozen=True)
class WorstEstimate:
    """One quantity of one device, in its unit: value, sd, 90 % interval and the truth; nan where unknown."""

    quantity: str
    value: float
    sd: float
    q05: float
    q95: float
    truth: float


@dataclass(frozen=True)
class WorstDevice:
    """One device, the reason for its selection, and its results.

    Parameters
    ----------
    device_id, lot, wafer, die_mm : identity and place of manufacture; nan if unknown.
    why : reason for its selection.
    verdict, status, reason, failed_limits : as in the results.
    p_pass, error : probability of conformity; rms of the residual [sigma].
    margin : distance of the estimates to the nearest limit (see ``Limit.margin``), negative outside.
    estimates : theta, split, c12, imbalance and the limited quantities.
    """

    device_id: str
    lot: str
    wafer: str
    die_mm: tuple[float, float]
    why: str
    verdict: str
    status: str
    reason: str
    failed_limits: str
    p_pass: float
    error: float
    margin: float
    estimates: tuple[WorstEstimate, ...]


def margins(devices: Devices, limits: Limits) -> FloatArray:
    """(B,) smallest ``Limit.margin`` over the limits whose quantity is known; nan if none is known."""
    least = np.full(len(devices), np.nan)
    for limit in limits.limits:
        np.fmin(least, limit.margin(devices.number(limit.quantity)), out=least)  # nan only where both are
    return least


def worst_devices(devices: Devices, limits: Limits, each: int = 2) -> tuple[WorstDevice, ...]:
    """The most informative devices of the run, without repetition.

    Up to ``each`` of the not identified (largest error), the undecided (p_pass nearest 1/2), the failed
    and the passed (smallest margin).
    """
    margin = margins(devices, limits)
    ok, undecided = devices.is_ok(), devices.has("undecided")
    p_pass, error = devices.number("p_pass"), devices.number("error")
    groups = (
        ("not identified: {status}", ~ok, -np.nan_to_num(error, nan=np.inf)),
        (
            "undecided: too close to a limit",
            ok & undecided,
            np.abs(np.nan_to_num(p_pass, nan=0.5) - 0.5),
        ),
        ("failed by the widest margin", ok & devices.has("fail"), np.nan_to_num(margin, nan=np.inf)),
        ("passed by the narrowest margin", ok & devices.has("pass"), np.nan_to_num(margin, nan=np.inf)),
    )
    rows = []
    for why, member, order in groups:
        for k in _least(member, order, each):
            rows.append(_describe(devices, limits, int(k), why, float(margin[k])))
    return tuple(rows)


def _least(member: BoolArray, order: FloatArray, count: int) -> IntArray:
    """Numbers of the ``count`` members of least ``order``, the first of equal ones first."""
    candidates = np.flatnonzero(member)
    if candidates.size > count:
        # Of a million members only those up to the last wanted value are sorted.
        last = np.partition(order[candidates], count - 1)[count - 1]
        candidates = candidates[order[candidates] <= last]
    return np.asarray(candidates[np.argsort(order[candidates], kind="stable")][:count])


_OWN = (
    *("device_id", "lot", "wafer", "die_x_mm", "die_y_mm"),
    *("verdict", "status", "status_reason", "failed_limits", "p_pass", "error"),
)
_ESTIMATE = ("{}", "{}_sd", "{}_q05", "{}_q95", "true_{}")


def device_estimates(devices: Devices, limits: Limits, device_id: str) -> tuple[WorstEstimate, ...]:
    """Theta, split, c12, imbalance and the limited quantities of one device; empty where there is no such device."""
    row = Devices(rows_of(devices.table, device_id))
    return _describe(row, limits, 0, "", float("nan")).estimates if len(row) else ()


def _describe(devices: Devices, limits: Limits, k: int, why: str, margin: float) -> WorstDevice:
    names = dict.fromkeys(("theta_deg", "split_hz", "c12_per_s", "sense_imbalance", *limits.quantities))
    shown = [*_OWN, *(column.format(name) for name in names for column in _ESTIMATE)]
    row = Devices(devices.table.select([name for name in shown if name in devices.table.column_names]).slice(k, 1))

    def number(name: str) -> float:
        return float(row.number(name)[0])

    def text(name: str) -> str:
        return row.text(name)[0]

    return WorstDevice(
        device_id=text("device_id"),
        lot=text("lot"),
        wafer=text("wafer"),
        die_mm=(number("die_x_mm"), number("die_y_mm")),
        why=why.format(status=text("status")),
        verdict=text("verdict"),
        status=text("status"),
        reason=text("status_reason"),
        failed_limits=text("failed_limits"),
        p_pass=number("p_pass"),
        error=number("error"),
        margin=margin,
        estimates=tuple(WorstEstimate(name, *(number(column.format(name)) for column in _ESTIMATE)) for name in names),
    )
