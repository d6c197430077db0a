"""Yields, risks and capabilities as plain data for JSON; infinite numbers become null."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from reports.capability import Capability, Index
from reports.decision_risk import DecisionRisk, RiskCurve, RiskShare
from reports.limits import Limits
from reports.yields import Interval, Yield


def limits_table(limits: Limits) -> dict[str, Any]:
    """Limits and rule; an end that is not limited is null."""
    rule = {key: value for key, value in asdict(limits.rule).items() if value is not None}
    if limits.rule.by_estimate:
        rule = {key: value for key, value in rule.items() if key not in ("pass_at", "fail_at")}
    return {"rule": rule, "limits": {one.quantity: {"min": one.low, "max": one.high} for one in limits.limits}}


def yield_table(found: Yield) -> dict[str, Any]:
    """A yield with its 95 % interval."""
    return {
        "devices": found.devices,
        "pass": found.passed,
        "fail": found.failed,
        "undecided": found.undecided,
        "yield": found.value,
        "low": found.clopper_pearson.low,
        "high": found.clopper_pearson.high,
    }


def interval_table(found: Interval | None) -> list[float] | None:
    """Both ends, or null."""
    return None if found is None else [found.low, found.high]


def risk_table(row: DecisionRisk) -> dict[str, Any]:
    """The risks of one quantity, or of all limits together (quantity null)."""
    return {
        "quantity": None if row.limit is None else row.limit.quantity,
        "judged": row.judged,
        "accepted": row.accepted,
        "undecided": row.undecided,
        "specific_mean": row.specific_mean,
        "specific_most": row.specific_most,
        "consumer": _share(row.consumer),
        "producer": _share(row.producer),
    }


def _share(found: RiskShare) -> dict[str, Any]:
    return {
        "value": found.value,
        "interval": interval_table(found.interval),
        "normal_process": found.normal,
        "expected_wrong": [found.expected, found.expected_low, found.expected_high],
        "true_wrong": found.counted,
        "true_interval": interval_table(found.counted_interval),
    }


def risk_curve_table(found: RiskCurve | None) -> dict[str, Any] | None:
    """Accepted share and risks against the factor of a guard band."""
    return None if found is None else asdict(found)


def capability_table(row: Capability) -> dict[str, Any]:
    """Indices of one quantity, each [value, low, high]; null where there is none, or no end."""
    indices = {name: _index(getattr(row, name)) for name in ("cp", "cpk", "pp", "ppk")}
    rest = ("devices", "groups", "mean", "sigma", "sigma_within", "uncertainty", "outside", "found_outside", "reason")
    return {"quantity": row.limit.quantity, **indices, **{name: getattr(row, name) for name in rest}}


def _index(index: Index | None) -> list[float] | None:
    return None if index is None else [index.value, index.low, index.high]
