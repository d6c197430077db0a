"""Declaration of `gyroscreen benchmark hidden-irregularities` and `lot-origin`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .options import Json, Seed, Workers


def hidden_irregularities(
    kind: Annotated[str, typer.Option(help="none, one, two, left-out, outside, or all.")] = "all",
    lots: Annotated[int, typer.Option(help="Lots of each kind.")] = 20,
    seed: Seed = 1,
    out: Annotated[Path, typer.Option(help="Folder for the rows; an interrupted study continues there.")] = Path(
        "hidden-irregularities"
    ),
    json: Json = False,
) -> None:
    """How often refine is right about a lot with a hidden irregularity."""
    from ..lot import hidden_irregularities as command

    command(kind, lots, seed, out, json)


def lot_origin(
    kind: Annotated[str, typer.Option(help="For example none-60,spread-200; or all.")] = "all",
    rows: Annotated[int, typer.Option(help="Nights of each kind; 0: show the stored ones.")] = 100,
    seed: Seed = 1,
    workers: Workers = 0,
    out: Annotated[Path, typer.Option(help="Folder for the rows; an interrupted study continues there.")] = Path(
        "lot-origin"
    ),
    json: Json = False,
) -> None:
    """How often a night says rightly where its lot comes from."""
    from ..lot_origin import lot_origin as command

    command(kind, rows, seed, workers, out, json)
