"""Limits of the result quantities, and the rule by which a device is judged.

    [rule]
    name = "probability"
    pass_at = 0.95
    fail_at = 0.05
    [limits.split_hz]
    max = 3.0
    [limits.theta_deg]          # an axis: the arc from min up to max, modulo 180
    min = 80
    max = 100

A value conforms when min <= value <= max; the limits themselves conform.  The other rules: ``reports.rules``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from msgspec import Struct

from pipeline.arrays import BoolArray, FloatArray
from pipeline.axial import PERIOD_DEG, in_arc
from pipeline.errors import ConfigError
from pipeline.experiment.files.common_tables import Value
from pipeline.quantities import AXES, NAMES
from pipeline.toml_files import check_known, converted, load
from pipeline.toml_keys import Meaning

from .rules import Rule, RuleName, RuleTable, rule_of


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

    @property
    def width(self) -> float:
        """high - low; the magnitude of the limit where there is only one."""
        if math.isfinite(self.low) and math.isfinite(self.high):
            return self.high - self.low
        return abs(self.low if math.isfinite(self.low) else self.high)

    def admits(self, values: FloatArray) -> BoolArray:
        """Whether low <= value <= high, or the axis is in the arc, for each value (...); nan does not conform."""
        if self.axis:
            return in_arc(values, self.low, self.high)
        return np.asarray((values >= self.low) & (values <= self.high))

    def beyond(self, values: FloatArray) -> tuple[FloatArray, ...]:
        """How far values (...) lie beyond each finite end, low first [unit of the quantity]: positive outside, inf for nan.

        For an axis: beyond the low and the high end of the arc, by the shorter way round from its middle.
        """
        if self.axis:
            half = 0.5 * (self.high - self.low)
            away = np.mod(values - (self.low + half) + 0.5 * PERIOD_DEG, PERIOD_DEG) - 0.5 * PERIOD_DEG
            found = [-away - half, away - half]
        else:
            ends = ((self.low, self.low - values), (self.high, values - self.high))
            found = [excess for end, excess in ends if math.isfinite(end)]
        return tuple(np.where(np.isnan(excess), np.inf, excess) for excess in found)

    def margin(self, values: FloatArray) -> FloatArray:
        """Distance (...) to the nearest limit, in half-widths of the tolerance or in units of a single limit.

        Positive inside, 1 in the middle of a tolerance; nan where the value is.
        """
        if self.axis:
            half = 0.5 * (self.high - self.low)
            centre = self.low + half
            away = np.abs(np.mod(values - centre + 0.5 * PERIOD_DEG, PERIOD_DEG) - 0.5 * PERIOD_DEG)
            return np.asarray((half - away) / half)
        both = math.isfinite(self.low) and math.isfinite(self.high)
        scale = 0.5 * self.width if both else self.width
        # A limit at zero, or a tolerance of no width, has no scale of its own.
        scale = scale or 1.0
        return np.asarray(np.minimum(values - self.low, self.high - values) / scale)


class BoundsTable(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """``[limits.<quantity>]``: one limit or both."""

    min: Annotated[Value | None, Meaning("least conforming value; absent: no lower limit", "that of the quantity")] = (
        None
    )
    max: Annotated[
        Value | None, Meaning("largest conforming value; absent: no upper limit", "that of the quantity")
    ] = None


class LimitsTable(Struct, frozen=True, forbid_unknown_fields=True):
    """A limits file."""

    rule: Annotated[RuleTable | RuleName, Meaning("rule by which a device is judged: a name or a table")] = RuleTable()
    limits: Annotated[dict[str, BoundsTable], Meaning("limits by quantity, one table each")] = {}


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
    """Limits from a TOML table with ``[rule]`` and ``[limits.<quantity>]``, or from a file that contains it.

    Parameters
    ----------
    table : the table, or the path of a TOML file.  ``[rule]`` may be left out (0.95 and 0.05).

    Raises
    ------
    ConfigError : the file cannot be read; an unknown key, rule or quantity; a limit that is empty, crossed or not
        finite; an arc that is not shorter than 180 deg; a rule as in :func:`reports.rules.rule_of`.
    """
    if isinstance(table, Path):
        where = table.name
        found = load(table, LimitsTable, "limits file", "start from a copy of reports/limits_default.toml")
    else:
        where = "limits"
        found = converted(dict(table), LimitsTable, where)
    if not found.limits:
        raise ConfigError(
            f"{where}: no limits are given",
            allowed="at least one [limits.<quantity>] with min, max or both",
            next_step="add for example [limits.split_hz] max = 3.0",
        )
    return checked_limits(found.rule, found.limits, where)


def checked_limits(rule: RuleTable | RuleName, bounds: Mapping[str, BoundsTable], where: str) -> Limits:
    """Limits from decoded tables; ``where`` names their file in messages.

    Raises
    ------
    ConfigError : as :func:`load_limits`.
    """
    return Limits(rule_of(rule, where), tuple(_limit(name, table, where) for name, table in bounds.items()))


def _limit(name: str, bounds: BoundsTable, where: str) -> Limit:
    check_known(name, NAMES, f"{where}: [limits]", "quantity")
    place = f"{where}: [limits.{name}]"
    if bounds.min is None and bounds.max is None:
        raise ConfigError(
            f"{place} limits nothing",
            allowed="min, max or both",
            next_step="give a limit or leave the table out",
        )
    low = -math.inf if bounds.min is None else bounds.min
    high = math.inf if bounds.max is None else bounds.max
    if low > high:
        raise ConfigError(
            f"{place} limits are crossed: min is above max",
            value={"min": low, "max": high},
            allowed="min <= max; an arc across 90 deg is written min = 80, max = 100",
            next_step="exchange the two or correct one",
        )
    if name in AXES and not 0.0 < high - low < PERIOD_DEG:
        raise ConfigError(
            f"{place} is not an arc of axes",
            value={"min": bounds.min, "max": bounds.max},
            allowed="both min and max, 0 < max - min < 180 deg",
            next_step="give both ends, going up from min to max",
        )
    return Limit(name, low, high)


def bounds_of(limits: Limits) -> dict[str, BoundsTable]:
    """The limits as the tables of a file."""
    return {
        one.quantity: BoundsTable(*(end if math.isfinite(end) else None for end in (one.low, one.high)))
        for one in limits.limits
    }


DEFAULT_FILE = Path(__file__).with_name("limits_default.toml")
DEFAULT_LIMITS: Limits = load_limits(DEFAULT_FILE)
