"""gyroscreen benchmark efficiency."""

from __future__ import annotations

from pathlib import Path

from ..studies.efficiency import BLOCK, CELLS, figures, run_study
from ..studies.hidden.study import rows_in
from .benchmark import follow, show


def efficiency(cell: str, devices: int, seed: int, workers: int, out: Path, json: bool) -> None:
    """See ``gyroscreen benchmark efficiency --help``."""
    cells = tuple(CELLS) if cell == "all" else (cell,)
    follow(run_study(cells, devices, seed, out, workers), f"blocks of {BLOCK} devices")
    show(figures([row for row in rows_in(out, cells, seed) if row["number"] * BLOCK < devices]), json)
