"""The scaling study: the points that are missing, one after the other, a line each; an interrupted study goes on.

    DIR/<kind>.jsonl    one JSON object per point: processor time, wall time [s], peak memory [MB], files, bytes

Points are measured one at a time, because they would otherwise measure each other.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from ..hidden.study import append, make_folder, rows_in
from .measure import measured
from .points import VALUES, Point

_WORK = "work"


def run_study(points: Sequence[Point], seed: int, folder: Path) -> Iterator[tuple[int, int]]:
    """Measure the points that are missing in ``folder``; yields (points done, points planned) after each.

    Raises
    ------
    UsageError : a folder that cannot be written.
    """
    make_folder(folder)
    before = {(row["kind"], row["number"]) for row in rows_of(folder, seed)}
    done = sum((point.kind, point.number) in before for point in points)
    for point in points:
        if (point.kind, point.number) in before:
            continue
        append(folder, measured(point, seed, folder / _WORK))
        done += 1
        yield done, len(points)


def rows_of(folder: Path, seed: int) -> list[dict[str, Any]]:
    """The finished rows, in the order of the points."""
    rows = {(row["kind"], row["number"]): row for row in rows_in(folder, tuple(VALUES), seed)}
    order = {kind: i for i, kind in enumerate(VALUES)}
    return sorted(rows.values(), key=lambda row: (order[row["kind"]], row["value"], row["workers"]))
