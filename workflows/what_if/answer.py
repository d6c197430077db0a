"""A what-if as JSON."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

from pipeline.plain import plain
from reports.what_if.content import YieldPair

from .run import JudgedRun
from .tables import capability_table, interval_table, limits_table, risk_table, yield_table


def answer(found: JudgedRun, page: Path) -> dict[str, Any]:
    """The content of the page as plain data; shares are between 0 and 1, unknown numbers are null."""
    c = found.content
    table = {
        "run_id": c.run_id,
        "report": str(page),
        "limits": {"old": limits_table(c.old), "new": limits_table(c.new)},
        "yield": {"old": yield_table(c.total.old), "new": yield_table(c.total.new)},
        "difference": {
            "value": c.total.new.value - c.total.old.value,
            "low": c.difference.low,
            "high": c.difference.high,
            "method": c.difference.method,
        },
        "lots": [_pair(row) for row in c.lots],
        "wafers": [_pair(row) for row in c.wafers],
        "process": {
            new.by: {"old": interval_table(old.interval), "new": interval_table(new.interval)}
            for old, new in c.clusters
        },
        "transitions": [{"old": old, "new": new, "devices": n} for old, new, n in c.transitions],
        "changed_by": [asdict(row) for row in c.changes],
        "changed": [asdict(row) for row in c.changed],
        "curves": [
            {
                "quantity": curve.limit.quantity,
                "end": "max" if curve.high else "min",
                "old": curve.old,
                "new": curve.new,
                "positions": curve.positions,
                "yield": curve.share,
                "low": curve.low,
                "high": curve.high_share,
            }
            for curve in c.curves
        ],
        "lost_alone": {limit.quantity: n for limit, n in c.singles},
        "pairs": [
            {
                "quantities": [row.first.quantity, row.second.quantity],
                "first_alone": row.first_alone,
                "second_alone": row.second_alone,
                "only_both": row.both,
                "share": row.devices / c.total.new.devices,
                "low": row.share.low,
                "high": row.share.high,
            }
            for row in c.pairs
        ],
        "risks": {
            name: [risk_table(row) for row in rows] for name, rows in (("old", c.risks_old), ("new", c.risks_new))
        },
        "capability": [capability_table(row) for row in c.capabilities],
        "thinning": None if c.thinning is None else asdict(c.thinning),
        "statuses": {name: {"old": old, "new": new} for name, old, new in c.statuses},
    }
    result: dict[str, Any] = plain(table)
    return result


def _pair(row: YieldPair) -> dict[str, Any]:
    return {"lot": row.lot, "wafer": row.wafer, "old": yield_table(row.old), "new": yield_table(row.new)}
