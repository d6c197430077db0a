"""The guard: parts that became slower relative to the reference loop since their ratios were stored.

A part is slower where ratio > FACTOR median, with the stored median over several runs.  Ratios belong to one kernel of the BLAS
library, so those of another are not compared.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median

from .table import Results

#: Largest ratio of any part over its median: 1.11 in three runs at a load of 15 to 20 on two cores (docs/reference/parts.md).
FACTOR = 1.3


@dataclass(frozen=True)
class Spread:
    """Least, median and largest ratio of a part to the reference loop over ``runs`` runs."""

    least: float
    median: float
    largest: float
    runs: int


@dataclass(frozen=True)
class Stored:
    """The BLAS kernel of the runs, and the spread of each part."""

    blas: str
    parts: Mapping[str, Spread]


def spreads(runs: Sequence[Results]) -> dict[str, Spread]:
    """The spread of each part over ``runs``."""
    ratios: dict[str, list[float]] = {}
    for run in runs:
        for part in run.parts:
            ratios.setdefault(part.name, []).append(part.ratio)
    return {name: Spread(min(own), median(own), max(own), len(own)) for name, own in ratios.items()}


def read_stored(path: Path) -> Stored:
    """The stored ratios; OSError or ValueError where there are none."""
    table = json.loads(path.read_text(encoding="utf-8"))
    return Stored(str(table["blas"]), {str(name): Spread(**own) for name, own in table["parts"].items()})


def write_stored(path: Path, stored: Stored) -> None:
    """Store the ratios, to four digits."""
    parts = {
        name: {key: float(f"{value:.4g}") if isinstance(value, float) else value for key, value in asdict(own).items()}
        for name, own in stored.parts.items()
    }
    path.write_text(json.dumps({"blas": stored.blas, "parts": parts}, indent=2) + "\n", encoding="utf-8")


def slower(results: Results, stored: Stored, factor: float = FACTOR) -> dict[str, tuple[float, float]]:
    """Part -> (stored median, ratio now) of the parts that are slower by more than ``factor``."""
    found = {}
    for part in results.parts:
        own = stored.parts.get(part.name)
        if own is not None and part.ratio > factor * own.median:
            found[part.name] = (own.median, part.ratio)
    return found


def spread_table(stored: Stored) -> str:
    """The stored ratios as Markdown."""
    lines = ["| part | ratio, median | least / median | largest / median |", "|---|---|---|---|"]
    for name, own in stored.parts.items():
        least, largest = own.least / own.median, own.largest / own.median
        lines.append(f"| {name} | {own.median:.3g} | {least:.2f} | {largest:.2f} |")
    return "\n".join(lines) + "\n"
