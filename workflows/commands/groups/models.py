"""Declaration of the commands of `gyroscreen model`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from . import complete
from .options import CampaignFolder, EffectFolders

app = typer.Typer(help="Show, change and export models.", no_args_is_help=True)
ModelFile = Annotated[Path, typer.Argument(help="Model file (TOML).")]
EffectName = Annotated[str, typer.Argument(help="Name of the effect.", autocompletion=complete.effects)]


@app.command()
def show(file: ModelFile) -> None:
    """Show a model file and its parameters."""
    from ..model import show as command

    command(file)


@app.command()
def add(effect: EffectName, file: ModelFile, effects: EffectFolders = None) -> None:
    """Add an effect to a model file; create the file if needed."""
    from ..model import change as command

    command(effect, file, True, effects or [])


@app.command()
def drop(effect: EffectName, file: ModelFile) -> None:
    """Remove an effect from a model file."""
    from ..model import change as command

    command(effect, file, False, [])


@app.command()
def export(
    measurement: CampaignFolder,
    out: Annotated[Path | None, typer.Option(help="A .json or .mat file; default: DEVICE.json.")] = None,
) -> None:
    """Identify a device and write its state-space model.

    The file contains the continuous and the ZOH-discrete matrices and the covariance of the parameters.
    """
    from ..model import export as command

    command(measurement, out)
