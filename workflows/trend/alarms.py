"""The alarms of a trend: those of [trend] in the run's configuration, and those of --alarm, which replace them key by key."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import msgspec

from pipeline.errors import UsageError
from pipeline.toml_files import converted
from reports.trend.charted import night_limits

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
    night_limits(found.limits, "--alarm" if options else "[trend]")
    return found
