"""Declaration of `gyroscreen benchmark hidden-irregularities`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .options import Json, Seed


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
