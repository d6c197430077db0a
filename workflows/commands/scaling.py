"""gyroscreen benchmark scaling."""

from __future__ import annotations

import json as json_
from pathlib import Path

from ..studies.scaling.cost import cost_of, cost_table, tables_of
from ..studies.scaling.points import points_of
from ..studies.scaling.study import rows_of, run_study
from .benchmark import follow


def scaling(kind: str, largest: int, devices: int, seed: int, out: Path, json: bool) -> None:
    """See ``gyroscreen benchmark scaling --help``."""
    follow(run_study(points_of(kind, largest), seed, out), "points")
    rows = rows_of(out, seed)
    if json:
        found = [{"name": c.name, "low": c.low, "high": c.high, "unit": c.unit} for c in cost_of(rows, devices)]
        print(json_.dumps({"rows": rows, "cost": found}))
        return
    print(tables_of(rows))
    print(cost_table(cost_of(rows, devices), devices))
