"""Health of the identification: convergence, misfit, and comparison of the paper's route with the posterior."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from pipeline.arrays import FloatArray
from pipeline.axial import difference

from ..coded import paired
from ..devices import Devices
from ..order_statistics import quantiles

_NUMBER = re.compile(r"\d+(\.\d+)?(e[-+]?\d+)?")
ROUTE_THETAS = ("theta_u1_deg", "theta_v1_deg", "theta_u2_deg", "theta_v2_deg")


@dataclass(frozen=True)
class StatusCount:
    """Devices of one status and one reason."""

    status: str
    reason: str
    devices: int


@dataclass(frozen=True)
class Spread:
    """5, 50 and 95 % points and extremes of one diagnostic over the devices that have it, in the unit of its column."""

    name: str
    devices: int
    least: float
    q05: float
    median: float
    q95: float
    greatest: float


@dataclass(frozen=True)
class RouteDifference:
    """An estimate of theta [deg] or split [Hz] against the posterior and against the truth.

    The medians and 90 % points are of absolute differences (for theta, of angles between axes); nan if there is
    nothing to compare with.
    """

    name: str
    unit: str
    devices: int
    posterior_median: float
    posterior_q90: float
    truth_median: float
    truth_q90: float


def status_counts(devices: Devices) -> tuple[StatusCount, ...]:
    """Status and reason, most frequent first, "ok" first of all; reasons that differ only in numbers are merged."""
    pairs, index = paired(devices.text("status"), devices.text("status_reason"))
    groups: dict[tuple[str, str], list[tuple[str, int]]] = {}
    for (status, reason), number in zip(pairs, np.bincount(index, minlength=len(pairs)).tolist(), strict=True):
        groups.setdefault((status, _NUMBER.sub("…", reason)), []).append((reason, number))
    rows = [
        StatusCount(status, dotted if len(reasons) > 1 else reasons[0][0], sum(number for _, number in reasons))
        for (status, dotted), reasons in groups.items()
    ]
    return tuple(sorted(rows, key=lambda row: (row.status != "ok", -row.devices, row.status, row.reason)))


def spreads(devices: Devices) -> tuple[Spread, ...]:
    """Spread of the diagnostics over the devices, without those that have no value."""
    names = (
        "error",
        "error_all_noise",
        "chi2_per_dof",
        "relative_error",
        "theta_bias_bound_deg",
        "effect_p_value",
        "rhat",
        "ess",
        "acceptance",
    )
    rows = []
    for name in names:
        values = devices.number(name)
        values = values[np.isfinite(values)]
        if values.size:
            q05, middle, q95 = quantiles(values, (0.05, 0.5, 0.95)).tolist()
            rows.append(Spread(name, int(values.size), float(values.min()), q05, middle, q95, float(values.max())))
    return tuple(rows)


def route_differences(devices: Devices) -> tuple[RouteDifference, ...]:
    """The paper's four thetas and split, and the posterior's own, against the posterior and the truth."""
    rows = [_route(devices, name, "theta_deg", "deg") for name in (*ROUTE_THETAS, "theta_deg")]
    rows += [_route(devices, name, "split_hz", "Hz") for name in ("arx_split_hz", "split_hz")]
    if not any(row.devices for row in rows if row.name in (*ROUTE_THETAS, "arx_split_hz")):
        return ()
    return tuple(row for row in rows if row.devices)


def miss(devices: Devices, name: str, against: str) -> FloatArray:
    """(B,) |difference| of two columns of the ok devices, in their unit, as axes [deg] if thetas; else nan."""
    a, b = devices.number(name), devices.number(against)
    away = np.abs(difference(a, b) if "theta" in name else a - b)
    return np.where(devices.is_ok(), away, np.nan)


def _route(devices: Devices, name: str, quantity: str, unit: str) -> RouteDifference:
    values = devices.number(name)
    posterior = _median_q90(miss(devices, name, quantity)) if name != quantity else (float("nan"), float("nan"))
    truth = _median_q90(miss(devices, name, f"true_{quantity}"))
    return RouteDifference(name, unit, int(np.sum(np.isfinite(values) & devices.is_ok())), *posterior, *truth)


def _median_q90(values: FloatArray) -> tuple[float, float]:
    values = values[np.isfinite(values)]
    middle, q90 = quantiles(values, (0.5, 0.9)).tolist()
    return middle, q90
