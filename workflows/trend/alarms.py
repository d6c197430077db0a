"""The alarms of a trend: those of [trend] in the run's configuration, and those of --alarm, which replace them key by key."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import msgspec

from pipeline.errors import ConfigError, UsageError
from pipeline.toml_files import check_known, converted
from reports.limits import BoundsTable, Limit
from reports.trend.content import CHARTED

from ..config_tables import TrendTable

_FALSE_ALARM = "false_alarm"


def given(table: TrendTable, options: Sequence[str]) -> TrendTable:
    """``table`` with the alarms in ``options``: "false_alarm=0.01", "yield.min=0.5", "f1_hz.max=540".

    Raises
    ------
    UsageError : not KEY=NUMBER.
    ConfigError : an unknown quantity, or a value out of range.
    """
    plain: dict[str, Any] = msgspec.to_builtins(table)
    for option in options:
        name, equals, text = option.partition("=")
        try:
            value = float(text)
        except ValueError:
            equals = ""
        quantity, dot, end = name.partition(".")
        known = name == _FALSE_ALARM or (dot and end in ("min", "max"))
        if not (equals and known):
            raise UsageError(
                "--alarm is not KEY=NUMBER",
                value=option,
                allowed="false_alarm=0.01, yield.min=0.5, or QUANTITY.min=.. and QUANTITY.max=.. for the mean of a night",
                next_step="correct --alarm",
            )
        if name == _FALSE_ALARM:
            plain[_FALSE_ALARM] = value
        else:
            plain["limits"].setdefault(quantity, {})[end] = value
    found = converted(plain, TrendTable, "--alarm" if options else "[trend]")
    night_limits(found, "--alarm" if options else "[trend]")
    return found


def night_limits(table: TrendTable, where: str) -> tuple[Limit, ...]:
    """The limits on yield and means of a night; ConfigError for one that cannot be used."""
    return tuple(_limit(name, bounds, where) for name, bounds in table.limits.items())


def _limit(name: str, bounds: BoundsTable, where: str) -> Limit:
    check_known(name, CHARTED, f"{where}: trend.limits", "quantity")
    low = -math.inf if bounds.min is None else bounds.min
    high = math.inf if bounds.max is None else bounds.max
    if bounds == BoundsTable() or low > high:
        raise ConfigError(
            f"{where}: trend.limits.{name} limits nothing, or its limits are crossed",
            value=_given(bounds),
            allowed="min, max or both, min <= max",
            next_step=f"correct trend.limits.{name}",
        )
    return Limit(name, low, high)


def _given(bounds: BoundsTable) -> Mapping[str, float | None]:
    return {"min": bounds.min, "max": bounds.max}
