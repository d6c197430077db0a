"""Limits: what a device must be, and by which rule it is judged.

    [rule]
    name = "probability"
    pass_at = 0.95
    fail_at = 0.05
    [limits.split_hz]
    max = 3.0
    [limits.theta_deg]          # an axis: the arc from min up to max, modulo 180
    min = 80
    max = 100

A value conforms when min <= value <= max; the limits themselves conform.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.arrays import BoolArray, FloatArray
from pipeline.axial import PERIOD_DEG, in_arc
from pipeline.errors import ConfigError
from pipeline.quantities import AXES, NAMES
from pipeline.toml_files import read_table


@dataclass(frozen=True)
class Rule:
    """pass where P(conform) >= pass_at, fail where P(conform) <= fail_at, undecided between."""

    name: str = "probability"
    pass_at: float = 0.95
    fail_at: float = 0.05

    @property
    def explanation(self) -> str:
        """The rule in one sentence."""
        return (
            f"A device passes when the posterior probability that it conforms to all limits together is at "
            f"least {self.pass_at:.3g}, fails when it is at most {self.fail_at:.3g}, and is undecided in "
            f"between, or when its identification is not ok."
        )


@dataclass(frozen=True)
class Limit:
    """min <= quantity <= max; an infinite end is no limit.  For an axis: the arc from min up to max."""

    quantity: str
    low: float
    high: float

    @property
    def axis(self) -> bool:
        """Whether the quantity is an angle modulo 180 deg."""
        return self.quantity in AXES

    def admits(self, values: FloatArray) -> BoolArray:
        """Whether each value (...) conforms; nan does not."""
        if self.axis:
            return in_arc(values, self.low, self.high)
        return np.asarray((values >= self.low) & (values <= self.high))

    def margin(self, values: FloatArray) -> FloatArray:
        """Distance (...) to the nearest limit in half-widths of the tolerance, or in units of a single limit.

        Positive inside, 1 in the middle of a tolerance; nan where the value is.
        """
        if self.axis:
            half = 0.5 * (self.high - self.low)
            centre = self.low + half
            away = np.abs(np.mod(values - centre + 0.5 * PERIOD_DEG, PERIOD_DEG) - 0.5 * PERIOD_DEG)
            return np.asarray((half - away) / half)
        if math.isfinite(self.low) and math.isfinite(self.high):
            scale = 0.5 * (self.high - self.low)
        else:
            scale = abs(self.low if math.isfinite(self.low) else self.high)
        # A limit at zero, or a tolerance of no width, has no scale of its own.
        scale = scale or 1.0
        return np.asarray(np.minimum(values - self.low, self.high - values) / scale)


@dataclass(frozen=True)
class Limits:
    """All limits, in the order in which they were written, and the rule."""

    rule: Rule
    limits: tuple[Limit, ...]

    @property
    def quantities(self) -> tuple[str, ...]:
        """The limited quantities, in order."""
        return tuple(limit.quantity for limit in self.limits)


def load_limits(table: Mapping[str, Any] | Path) -> Limits:
    """Limits from a TOML table with ``[rule]`` and ``[limits.<quantity>]``, or from a file that holds it.

    Parameters
    ----------
    table : the table, or the path of a TOML file.  ``[rule]`` may be left out (0.95 and 0.05).

    Raises
    ------
    ConfigError : the file cannot be read; an unknown key, rule or quantity; a limit that is empty, crossed
        or not finite; an arc that is not shorter than 180 deg; thresholds that are not 0 <= fail_at <
        pass_at <= 1.
    """
    if isinstance(table, Path):
        otherwise = "start from a copy of limits_default.toml in reports"
        table = read_table(table, "limits file", "[rule] and [limits.<quantity>] tables", otherwise)
    _known("limits table", table, ("rule", "limits"))
    limits = _table("[limits]", table.get("limits", {}))
    if not limits:
        raise ConfigError(
            "no limits are given",
            allowed="at least one [limits.<quantity>] with min, max or both",
            next_step="add for example [limits.split_hz] max = 3.0",
        )
    return Limits(
        _rule(_table("[rule]", table.get("rule", {}))),
        tuple(_limit(name, _table(f"[limits.{name}]", bounds)) for name, bounds in limits.items()),
    )


def _table(name: str, value: Any) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise ConfigError(
            f"{name} is not a table", value=value, allowed="a TOML table", next_step="write it as a table"
        )
    return value


def _known(where: str, table: Mapping[str, Any], allowed: tuple[str, ...]) -> None:
    for key in table:
        if key not in allowed:
            raise ConfigError(
                f"unknown key in {where}",
                value=key,
                allowed=", ".join(allowed),
                next_step=_nearest(key, allowed),
            )


def _nearest(word: object, words: tuple[str, ...]) -> str:
    near = difflib.get_close_matches(str(word), words, n=1, cutoff=0.4)
    return f"did you mean {near[0]}?" if near else "use one of the names allowed"


def _number(where: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ConfigError(
            f"{where} is not a finite number",
            value=value,
            allowed="a finite number",
            next_step="leave the key out where there is no limit",
        )
    return float(value)


def _rule(table: Mapping[str, Any]) -> Rule:
    _known("[rule]", table, ("name", "pass_at", "fail_at"))
    name = table.get("name", Rule.name)
    if name != Rule.name:
        raise ConfigError(
            "unknown decision rule",
            value=name,
            allowed=f'"{Rule.name}"',
            next_step=f'write name = "{Rule.name}"',
        )
    pass_at = _number("[rule] pass_at", table.get("pass_at", Rule.pass_at))
    fail_at = _number("[rule] fail_at", table.get("fail_at", Rule.fail_at))
    if not 0.0 <= fail_at < pass_at <= 1.0:
        raise ConfigError(
            "thresholds of the rule are crossed or are not probabilities",
            value={"pass_at": pass_at, "fail_at": fail_at},
            allowed="0 <= fail_at < pass_at <= 1",
            next_step="for example pass_at = 0.95, fail_at = 0.05",
        )
    return Rule(name, pass_at, fail_at)


def _limit(name: str, bounds: Mapping[str, Any]) -> Limit:
    where = f"[limits.{name}]"
    if name not in NAMES:
        raise ConfigError(
            "limit on an unknown quantity",
            value=name,
            allowed=", ".join(NAMES),
            next_step=_nearest(name, NAMES),
        )
    _known(where, bounds, ("min", "max"))
    if not bounds:
        raise ConfigError(
            f"{where} limits nothing",
            allowed="min, max or both",
            next_step="give a limit or leave the table out",
        )
    low = _number(f"{where} min", bounds["min"]) if "min" in bounds else -math.inf
    high = _number(f"{where} max", bounds["max"]) if "max" in bounds else math.inf
    if low > high:
        raise ConfigError(
            f"{where} limits crossed: min is above max",
            value={"min": low, "max": high},
            allowed="min <= max; an arc across 90 deg is written min = 80, max = 100",
            next_step="exchange the two or correct one",
        )
    if name in AXES and not 0.0 < high - low < PERIOD_DEG:
        raise ConfigError(
            f"{where} is not an arc of axes",
            value={key: bounds[key] for key in bounds},
            allowed="both min and max, 0 < max - min < 180 deg",
            next_step="give both ends, going up from min to max",
        )
    return Limit(name, low, high)


DEFAULT_LIMITS: Limits = load_limits(Path(__file__).with_name("limits_default.toml"))
