"""Declaration of the benchmark of nights against nights."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .options import Json, Seed, Workers


def trend(
    series: Annotated[int, typer.Option(help="Simulated series of normal nights per case.")] = 20_000,
    rows: Annotated[int, typer.Option("--nights", help="Series of nights drawn from the population; 0: none.")] = 1000,
    seed: Seed = 1,
    workers: Workers = 0,
    out: Annotated[Path, typer.Option(help="Folder for the rows; an interrupted study continues there.")] = Path(
        "trend"
    ),
    json: Json = False,
) -> None:
    """False alarms of nights in control, and found shifts.

    The nights are normal, or drawn from the default population with its lots, wafers and dies.
    """
    from ..trend_study import trend_study as command

    command(series, rows, seed, workers, out, json)


BENCHMARKS = (trend,)
