"""gyroscreen export."""

from __future__ import annotations

import sys
from pathlib import Path

from pipeline.errors import printable

from ..screening.exports import export as exported


def export(run: str | None, results: Path, format: str | None, out: Path | None) -> None:
    """See ``gyroscreen export --help``."""
    found = exported(results, run, format, out)
    for remark in found.remarks:
        print(remark, file=sys.stderr)
    for file in found.files:
        print(printable(str(file)))
