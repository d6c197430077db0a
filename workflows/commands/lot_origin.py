"""gyroscreen benchmark lot-origin."""

from __future__ import annotations

from pathlib import Path

from ..studies.hidden.study import rows_in
from ..studies.lot_origin import KINDS, figures, run_study
from .benchmark import follow, show


def lot_origin(kind: str, rows: int, seed: int, workers: int, out: Path, json: bool) -> None:
    """See ``gyroscreen benchmark lot-origin --help``."""
    kinds = KINDS if kind == "all" else tuple(kind.split(","))
    if rows:
        follow(run_study(kinds, rows, seed, out, workers), "nights")
    show(figures(rows_in(out, kinds, seed)), json)
