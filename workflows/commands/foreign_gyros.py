"""gyroscreen benchmark foreign-gyros."""

from __future__ import annotations

from pathlib import Path

from ..studies.foreign_gyros import KINDS, figures, run_study
from ..studies.hidden.study import rows_in
from .benchmark import follow, show


def foreign_gyros(kind: str, devices: int, seed: int, workers: int, out: Path, json: bool) -> None:
    """See ``gyroscreen benchmark foreign-gyros --help``."""
    kinds = tuple(KINDS) if kind == "all" else (kind,)
    follow(run_study(kinds, devices, seed, out, workers), "devices")
    show(figures([row for row in rows_in(out, kinds, seed) if row["number"] < devices]), json)
