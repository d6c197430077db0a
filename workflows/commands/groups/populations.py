"""Declaration of the commands of `gyroscreen population`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from . import complete

app = typer.Typer(help="Show and change populations.", no_args_is_help=True)
PopulationFile = Annotated[Path, typer.Argument(help="Population file (TOML).")]
IrregularityName = Annotated[
    str, typer.Argument(help="Name of the irregularity.", autocompletion=complete.irregularities)
]


@app.command()
def show(
    name: Annotated[
        str,
        typer.Argument(help="A shipped population, or a population file (TOML).", autocompletion=complete.populations),
    ] = "cloverleaf",
) -> None:
    """Print a population as one complete, commented file.

    It lists every irregularity of the library with unit, range, default, meaning and source.
    """
    from ..population import show as command

    command(name)


@app.command()
def add(name: IrregularityName, file: PopulationFile) -> None:
    """Add the commented table of an irregularity to a population file.

    The file is created if needed, and then extends the shipped population.
    """
    from ..population import change as command

    command(name, file, True)


@app.command()
def drop(name: IrregularityName, file: PopulationFile) -> None:
    """Remove an irregularity from a population file."""
    from ..population import change as command

    command(name, file, False)
