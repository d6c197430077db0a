"""Arguments and options that several commands share."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import typer

from pipeline.errors import UsageError

from . import complete

Json = Annotated[bool, typer.Option("--json", help="Write one JSON object to stdout and nothing else.")]
Results = Annotated[Path, typer.Option("--results", help="Folder that contains the runs.")]
DEFAULT_RESULTS = Path("results")
RunId = Annotated[str | None, typer.Argument(help="Id of the run; default: the latest.", autocompletion=complete.runs)]

CampaignFolder = Annotated[Path, typer.Argument(help="A campaign folder or a record file.")]
Measurement = Annotated[Path, typer.Argument(help="A campaign folder, a record file or a modal record (TOML).")]
LotOrMeasurement = Annotated[
    Path, typer.Argument(help="A campaign folder, a record file, a modal record, or a lot (lot.toml, a run).")
]
PopulationFile = Annotated[
    Path | None,
    typer.Option(
        "--population",
        help="Population file of a lot; default for gyros: the shipped one.",
        autocompletion=complete.populations,
    ),
]
StartModel = Annotated[Path | None, typer.Option("--model", help="Model file; default: the paper's model.")]
PageFolder = Annotated[Path | None, typer.Option("--out", help="Write the page and its files to this folder.")]
EffectFolders = Annotated[
    list[Path] | None, typer.Option("--effects", help="Folder with your own effects; can be repeated.")
]
LimitsFile = Annotated[
    Path | None, typer.Option("--limits", help="Limits (TOML) that judge the device; default: shipped.")
]

Seed = Annotated[int, typer.Option(help="Seed of all random streams.")]
Workers = Annotated[int, typer.Option(help="Number of local worker processes; 0: one per core.")]
Devices = Annotated[int, typer.Option(help="Number of virtual devices.")]
Posterior = Annotated[
    int | None,
    typer.Option(help="Of a lot: sample the posterior of the N most influential spreads (1 to 6)."),
]


def only_with(option: str, others: Mapping[str, object]) -> None:
    """Check that no option among ``others`` is given, as they belong to ``option``.

    Raises
    ------
    UsageError : one is given.
    """
    for name, value in others.items():
        if value:
            raise UsageError(f"{name} belongs to {option}", next_step=f"give {option} too, or leave {name} out")
