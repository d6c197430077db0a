"""gyroscreen benchmark trend."""

from __future__ import annotations

from pathlib import Path

from ..studies.hidden.study import rows_in
from ..studies.trend import KIND, figures, run_study
from .benchmark import follow, show


def trend_study(series: int, rows: int, seed: int, workers: int, out: Path, json: bool) -> None:
    """See ``gyroscreen benchmark trend --help``."""
    if rows:
        follow(run_study(rows, seed, out, workers), "series")
    show(figures(rows_in(out, (KIND,), seed), series, seed), json)
