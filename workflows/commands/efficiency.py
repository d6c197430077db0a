"""gyroscreen benchmark efficiency."""

from __future__ import annotations

import sys
from pathlib import Path

from ..studies.efficiency import BLOCK, CELLS, figures, run_study
from ..studies.hidden.study import rows_in
from .benchmark import show


def efficiency(cell: str, devices: int, seed: int, workers: int, out: Path, json: bool) -> None:
    """See ``gyroscreen benchmark efficiency --help``."""
    cells = tuple(CELLS) if cell == "all" else (cell,)
    for done, total in run_study(cells, devices, seed, out, workers):
        print(f"\r{done} of {total} blocks of {BLOCK} devices", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    show(figures([row for row in rows_in(out, cells, seed) if row["number"] * BLOCK < devices]), json)
