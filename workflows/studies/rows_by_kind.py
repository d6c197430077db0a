"""A study that makes equally many rows of each of its kinds, and goes on where it stopped."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from pipeline.errors import UsageError

from .hidden.study import make_folder, resumed, rows_in

Row = dict[str, Any]

#: Largest class that counts as an answer.
LARGEST_CLASS = 3


def add_rows(
    task: Callable[[int, tuple[str, int]], Row],
    known: Collection[str],
    kinds: Sequence[str],
    count: int,
    seed: int,
    folder: Path,
    workers: int,
) -> Iterator[tuple[int, int]]:
    """Add the missing rows ``task(seed, (kind, number))`` to the files in ``folder``; yields (done, total).

    Raises
    ------
    UsageError : a kind that is not ``known``, or the folder cannot be written.
    """
    for kind in kinds:
        if kind not in known:
            raise UsageError("no such kind", value=kind, allowed=f"all, {', '.join(known)}", next_step="correct --kind")
    make_folder(folder)
    wanted = [(kind, number) for number in range(count) for kind in kinds]
    before = {(row["kind"], row["number"]) for row in rows_in(folder, kinds, seed)}
    yield from resumed(task, seed, wanted, before, folder, workers)


def processor_times(rows: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """Median and largest processor time of the rows, as one figure; none without rows."""
    times = sorted(row["cpu_seconds"] for row in rows)
    if not times:
        return {}
    return {"processor time, median and largest": f"{times[len(times) // 2]:.1f}, {times[-1]:.1f} s"}


def outcome(truth: str | None, verdict: str, effects: Sequence[str], classes: Sequence[Sequence[str]]) -> str:
    """ "correct", "class" (of at most three with the truth), "wrong" (another effect is named), or "open"."""
    named = set(effects)
    if named == ({truth} if truth else set()):
        return "correct" if verdict in ("adequate", "class") else "open"
    if verdict not in ("adequate", "class"):
        return "open"
    alike = [set(one) for one in classes if truth in one]
    if truth and len(named) == 1 and any(named <= one and len(one) <= LARGEST_CLASS for one in alike):
        return "class"
    return "wrong" if named - {truth} else "open"


def is_right(row: Mapping[str, Any], truth: str | None) -> bool:
    """Whether a stored row names its truth, alone or in a class of at most three."""
    return _judged(row, truth) in ("correct", "class")


def is_wrong(row: Mapping[str, Any], truth: str | None) -> bool:
    """Whether a stored row names something else."""
    return _judged(row, truth) == "wrong"


def _judged(row: Mapping[str, Any], truth: str | None) -> str:
    # From the answer and not from the stored outcome, so that rows of older versions count as new ones do.
    return outcome(truth, row["verdict"], row["effects"], row["classes"]) if "verdict" in row else "failed"
