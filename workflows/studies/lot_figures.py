"""What a study of hidden irregularities says: shares with Clopper-Pearson 95 % intervals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from .coverage import Share

#: Largest class that still counts as an answer.
CLASS = 3


def figures(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Counts, totals and 95 % intervals of each figure."""
    found: dict[str, Any] = {}

    def share(name: str, own: Sequence[bool]) -> None:
        if own:
            one = Share(sum(own), len(own))
            found[name] = {"count": one.count, "of": one.total, "interval_95": list(one.interval)}

    by_kind = {
        kind: [row for row in rows if row["kind"] == kind] for kind in ("none", "one", "two", "left-out", "outside")
    }
    share("none: a name", [bool(row["named"]) for row in by_kind["none"]])
    one = by_kind["one"]
    share("one: correct, class of at most 3", [_correct(row) for row in one])
    share("one: a single wrong name", [len(row["named"]) == 1 and bool(row["wrong"]) for row in one])
    share("two: both", [all(row["right"]) for row in by_kind["two"]])
    share("left-out: unknown", [row["verdict"] == "unknown" for row in by_kind["left-out"]])
    share("outside: unknown", [row["verdict"] == "unknown" for row in by_kind["outside"]])
    for name, place in (("first", 0), ("last", -1)):
        own = [row["forecast"][place]["inside"] for row in rows if row["forecast"] and row["forecast"][place]]
        share(f"held-out yield inside its 90 % forecast, {name} rung", own)
    # The file holds the magnitudes that the lot was drawn with, so a ratio of 1 is the truth for what it does not lack.
    covered = [
        low <= 1.0 <= high
        for row in rows
        if row["kind"] == "none"
        for name, (_, low, high) in row.get("spread_ratios", {}).items()
        if name not in row["named"]
    ]
    share("spreads inside their 90 % interval, nothing hidden", covered)
    return found


def _correct(row: Mapping[str, Any]) -> bool:
    return all(row["right"]) and not row["wrong"] and row["largest_class"] <= CLASS
