"""The sheets of a night's workbook: yields, devices, limits, columns."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

from pipeline.quantities import QUANTITIES
from pipeline.store.schema import Column

from ..devices import ColumnSource
from ..limits import Limits
from ..yields import Yield
from .excel import Sheet

if TYPE_CHECKING:
    from ..run.content import RunContent

_YIELD = ("lot", "wafer", "devices", "passed", "failed", "undecided", "yield", "low", "high")
_YIELD_UNITS = ("", "", "1", "1", "1", "1", "share", "share, 95 % interval", "share, 95 % interval")


def night_sheets(devices: ColumnSource, content: RunContent, columns: Sequence[Column]) -> tuple[Sheet, ...]:
    """The sheets; columns of ``devices`` without any value are left out."""
    known = [one for one in columns if devices[one.name].null_count < devices.num_rows]
    names = [one.name for one in known]
    groups = [
        ("all", "", content.total),
        *((one.lot, one.wafer, one.result) for one in (*content.lots, *content.wafers)),
    ]
    yields = [(lot, wafer, *_counted(found)) for lot, wafer, found in groups]
    limits = _limit_rows(content.limits)
    meanings = [(one.name, one.unit, one.meaning) for one in known]
    return (
        Sheet("yields", _YIELD, _YIELD_UNITS, yields, len(yields)),
        Sheet("devices", names, [one.unit for one in known], _rows(devices, names), devices.num_rows),
        Sheet("limits", ("quantity", "unit", "min", "max"), (), limits, len(limits)),
        Sheet("columns", ("column", "unit", "meaning"), (), meanings, len(meanings)),
    )


def _rows(devices: ColumnSource, names: Sequence[str]) -> Iterator[tuple[Any, ...]]:
    for batch in devices.select(names).to_batches():
        yield from zip(*(column.to_pylist() for column in batch.columns), strict=True)


def _counted(found: Yield) -> tuple[float, ...]:
    interval = found.clopper_pearson
    return found.devices, found.passed, found.failed, found.undecided, found.value, interval.low, interval.high


def _limit_rows(limits: Limits) -> list[tuple[Any, ...]]:
    units = {quantity.name: quantity.unit for quantity in QUANTITIES}
    return [
        (one.quantity, units[one.quantity], *(end if math.isfinite(end) else None for end in (one.low, one.high)))
        for one in limits.limits
    ]
