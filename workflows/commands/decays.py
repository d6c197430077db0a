"""gyroscreen benchmark decays."""

from __future__ import annotations

from pathlib import Path

from ..studies.decays import KINDS, figures, run_study
from ..studies.hidden.study import rows_in
from .benchmark import follow, show


def decays(kind: str, campaigns: int, seed: int, workers: int, out: Path, json: bool) -> None:
    """See ``gyroscreen benchmark decays --help``."""
    kinds = tuple(KINDS) if kind == "all" else (kind,)
    follow(run_study(kinds, campaigns, seed, out, workers), "decays")
    show(figures([row for row in rows_in(out, kinds, seed) if row["number"] < campaigns]), json)
