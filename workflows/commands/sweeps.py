"""gyroscreen benchmark sweeps."""

from __future__ import annotations

import sys
from pathlib import Path

from ..studies.hidden.study import rows_in
from ..studies.sweeps import KINDS, figures, run_study
from .benchmark import show


def sweeps(kind: str, campaigns: int, seed: int, workers: int, out: Path, json: bool) -> None:
    """See ``gyroscreen benchmark sweeps --help``."""
    kinds = tuple(KINDS) if kind == "all" else (kind,)
    for done, total in run_study(kinds, campaigns, seed, out, workers):
        print(f"\r{done} of {total} campaigns", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    show(figures([row for row in rows_in(out, kinds, seed) if row["number"] < campaigns]), json)
