"""Declaration of the commands that open a local page."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .options import DEFAULT_RESULTS, EffectFolders, LimitsFile, PopulationFile, Results, StartModel


def explore(
    path: Annotated[
        Path | None,
        typer.Argument(
            help="A run (folder or id), a campaign, or a lot; default: the latest run.", metavar="[RUN|CAMPAIGN|LOT]"
        ),
    ] = None,
    results: Results = DEFAULT_RESULTS,
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port on this machine; 0: a free one.")] = 0,
    browser: Annotated[
        bool,
        typer.Option("--browser/--no-browser", help="Open the page in the browser; its address is always printed."),
    ] = True,
    model: StartModel = None,
    effects: EffectFolders = None,
    population: PopulationFile = None,
    limits: LimitsFile = None,
) -> None:
    """Open an interactive page of a run, a campaign or a lot.

    The page is served to this machine alone, at an address with a secret token, until Ctrl-C.  Nothing is written.
    --model and --effects belong to a campaign, --population and --limits to a lot; with --population a run is shown as a lot.
    """
    from ..explore import Given
    from ..explore import explore as command

    command(path, results, port, browser, Given(model, tuple(effects or ()), population, limits))


COMMANDS = (explore,)
