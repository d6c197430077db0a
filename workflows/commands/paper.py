"""gyroscreen paper."""

from __future__ import annotations

import json as json_
import sys
from pathlib import Path

from pipeline.plain import plain

from ..studies.paper.page import write_paper


def paper(out: Path, json: bool) -> None:
    """See ``gyroscreen paper --help``."""
    path, content, seconds = write_paper(out, say=lambda what: print(f"  {what}", file=sys.stderr))
    numbers = content.numbers
    if json:
        rows = [
            {
                "name": row.name, "where": row.where, "printed": row.value, "ours": row.ours,
                "record": row.record, "deviation": plain(row.deviation), "agrees": row.agrees, "remark": row.remark,
            }
            for row in numbers
        ]  # fmt: skip
        print(json_.dumps({"page": str(path), "seconds": seconds, "numbers": rows}))
        return
    same = sum(row.consistent for row in numbers)
    print(f"{path}: {same} of {len(numbers)} printed numbers are reproduced, the others are explained; {seconds:.0f} s")
