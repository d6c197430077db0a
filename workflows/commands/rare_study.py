"""gyroscreen benchmark rare."""

from __future__ import annotations

from pathlib import Path

from ..studies.hidden.study import rows_in
from ..studies.rare import KINDS, PLAIN, figures, run_study
from .benchmark import follow, show


def rare_study(kind: str, count: int, plain: int, seed: int, workers: int, out: Path, json: bool) -> None:
    """See ``gyroscreen benchmark rare --help``."""
    kinds = tuple(name for name in KINDS if name != PLAIN) if kind == "all" else (kind,)
    for own, rows in ((kinds, count), ((PLAIN,), plain)):
        follow(run_study(own, rows, seed, out, workers), "rows")
    show(figures(rows_in(out, (*kinds, PLAIN), seed)), json)
