"""The limits of a session: moved ones, and the file that states them."""

from __future__ import annotations

import math

import tomli_w
from msgspec import to_builtins

from reports.limits import Limit, Limits, bounds_of, checked_limits
from reports.rules import Rule, RuleTable


def moved(limits: Limits, quantity: str, low: float, high: float) -> Limits:
    """``limits`` with the limit of ``quantity`` at ``low`` and ``high``; removed where both are infinite, else added last.

    Raises
    ------
    ConfigError : crossed limits, an arc of 180 deg or more, or no limit left.
    """
    bounds = dict(bounds_of(limits))
    if math.isfinite(low) or math.isfinite(high):
        bounds |= bounds_of(Limits(limits.rule, (Limit(quantity, low, high),)))
    else:
        bounds.pop(quantity, None)
    return Limits(limits.rule, checked_limits(RuleTable(), bounds, "limits").limits)


def toml_of(limits: Limits) -> str:
    """The file that ``gyroscreen report --limits`` reads."""
    return tomli_w.dumps({"rule": _rule(limits.rule), "limits": to_builtins(bounds_of(limits))})


def _rule(rule: Rule) -> dict[str, object]:
    table = {"name": rule.name, "k": rule.k, "consumer_risk": rule.consumer_risk}
    if not rule.by_estimate:
        table |= {"pass_at": rule.pass_at, "fail_at": rule.fail_at}
    return {name: value for name, value in table.items() if value is not None}
