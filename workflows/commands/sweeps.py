"""gyroscreen benchmark sweeps."""

from __future__ import annotations

from pathlib import Path

from ..studies.hidden.study import rows_in
from ..studies.sweeps import KINDS, figures, run_study
from .benchmark import follow, show


def sweeps(kind: str, campaigns: int, seed: int, workers: int, out: Path, json: bool) -> None:
    """See ``gyroscreen benchmark sweeps --help``."""
    kinds = tuple(KINDS) if kind == "all" else (kind,)
    follow(run_study(kinds, campaigns, seed, out, workers), "campaigns")
    show(figures([row for row in rows_in(out, kinds, seed) if row["number"] < campaigns]), json)
