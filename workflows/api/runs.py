"""Start a run, or open a stored one; see :mod:`workflows.api`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from pipeline.errors import UsageError
from pipeline.store.folders import PREFIX
from pipeline.store.read import find_run

from ..config import load_config
from .night import ScreeningRun

DEFAULT_RESULTS = "results"


def open_run(run: str = "latest", results: str | Path = DEFAULT_RESULTS) -> ScreeningRun:
    """Open a stored run.

    Parameters
    ----------
    run : its id, "latest", or the path of its folder (``nightly/run=<id>``).
    results : folder that contains the runs; not used with the path of a folder.

    Raises
    ------
    UsageError : there is no such run, or none at all.
    IntegrityError : a manifest is damaged.

    Example
    -------
    >>> night = gs.open_run(results="nightly")
    >>> night.yields
    """
    if Path(run).name.startswith(PREFIX):
        folder = Path(run)
        run, results = folder.name.removeprefix(PREFIX), folder.parent
    found = find_run(Path(results), run)
    return ScreeningRun(Path(results), found.name.removeprefix(PREFIX))


def run(
    config: str | Path | None = None,
    *,
    devices: int | None = None,
    seed: int | None = None,
    out: str | Path = DEFAULT_RESULTS,
    workers: int = 0,
    quiet: bool = False,
) -> ScreeningRun:
    """Identify and judge a batch of devices on local workers, and store results and report, as ``gyroscreen run`` does.

    Parameters
    ----------
    config : run configuration (TOML); by default the shipped one, 200 devices of the paper's experiment.
    devices, seed : in place of those of the configuration.
    out : folder that contains the runs.
    workers : local worker processes; 0: one per core.
    quiet : show no progress.

    Raises
    ------
    ConfigError : a wrong key or value.
    IncompleteError : the run stopped before its end; ``gyroscreen run --resume latest`` continues it.

    Example
    -------
    >>> night = gs.run(devices=100, out="nightly")
    """
    from ..screening.batch import run_batch
    from ..screening.plan import plan, start

    if workers < 0:
        raise UsageError(
            "workers is negative", value=workers, allowed="0 (one per core) or more", next_step="correct it"
        )
    given: Mapping[str, int | None] = {"devices": devices, "seed": seed}
    overrides = {name: value for name, value in given.items() if value is not None}
    planned = plan(load_config(None if config is None else Path(config), overrides))
    planned, store = start(planned, Path(out))
    result = run_batch(planned, store, Path(out), workers, quiet=quiet)
    return ScreeningRun(Path(out), result.run_id)
