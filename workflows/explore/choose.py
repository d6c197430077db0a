"""What a path names, and the view that shows it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from bokeh.document import Document

from pipeline.device.model import DEFAULT_COMPARE_MODEL, Model
from pipeline.errors import UsageError
from pipeline.store.folders import PREFIX, run_folders
from pipeline.store.manifest import NAME as MANIFEST
from pipeline.store.read import find_run
from populations.spec import PopulationSpec
from reports.limits import DEFAULT_LIMITS, Limits

from ..lots.named import is_lot

Kind = Literal["night", "campaign", "lot"]


def kind_of(path: Path | None, results: Path) -> tuple[Kind, Path]:
    """What is to be shown, and its folder or file.

    Parameters
    ----------
    path : a run folder, a folder of runs (the newest), the id of a run in ``results``, a lot (lot.toml), or the measurement of
        one device; ``None``: the newest run in ``results``.
    results : folder of runs.

    Raises
    ------
    UsageError : there is nothing of the kind.
    """
    if path is None:
        return "night", find_run(results)
    if path.is_dir() and (path / MANIFEST).is_file():
        return "night", path
    if path.is_dir() and not (path / "lot.toml").is_file() and run_folders(path):
        return "night", find_run(path)
    if path.exists():
        return ("lot" if is_lot(path) else "campaign"), path
    if len(path.parts) == 1 and (path.name == "latest" or (results / f"{PREFIX}{path.name}").is_dir()):
        return "night", find_run(results, path.name)
    raise UsageError(
        "there is no such run, campaign or lot",
        value=str(path),
        allowed="the folder or id of a run, a campaign or record, a lot.toml",
        next_step="check the path; `gyroscreen run` makes a run, `gyroscreen simulate FOLDER` a campaign",
    )


@dataclass(frozen=True, eq=False)
class Start:
    """What the loop starts from: the model of a campaign; the population of a lot (or nothing), and its limits."""

    model: Model = DEFAULT_COMPARE_MODEL
    population: PopulationSpec | None = None
    limits: Limits = DEFAULT_LIMITS


def view_of(kind: Kind, path: Path, start: Start = Start()) -> Callable[[Document], None]:
    """The view of ``path``; its data are read here, once.

    Raises
    ------
    UsageError, ConfigError, MeasurementError, IntegrityError : the data cannot be shown.
    """
    if kind == "night":
        from .night import view as night

        return night(path)
    if kind == "campaign":
        from .campaign import view as campaign

        return campaign(path, start.model)
    from .lot import view as lot

    return lot(path, start.population, start.limits)
