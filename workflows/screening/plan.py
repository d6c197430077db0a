"""The plan of a run: its configuration, devices and blocks, for a new run or one that continues."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import tomli_w

from pipeline.errors import ConfigError
from pipeline.store.provenance import provenance
from pipeline.store.run import RunStore, create_run, open_run

from ..config import RunConfig, config_of_run, to_toml_table
from .band import check_band
from .block import DeviceBlock, blocks_of
from .campaign_block import campaign_folders, declared_id
from .settings import population
from .virtual_device import shared_record, virtual_model


@dataclass(frozen=True, eq=False)
class RunPlan:
    """Configuration, number of devices and blocks of a run, and the campaign folders if the devices are measured."""

    config: RunConfig
    devices: int
    blocks: tuple[DeviceBlock, ...]
    folders: tuple[Path, ...]


def plan(config: RunConfig) -> RunPlan:
    """The plan of a run; finds every fault that can be found before the first device.

    Raises
    ------
    ConfigError : population, effects, limits or campaigns cannot be used.
    """
    if config.source.kind == "population":
        population(config)
        virtual_model(config)
        shared_record(config)
        check_band(config)
        return RunPlan(config, config.run.devices, blocks_of(config, config.run.devices), ())
    root = Path(config.source.path or ".")
    folders = campaign_folders(root)
    if not folders:
        raise ConfigError(
            "source.path: the folder contains no campaign",
            value=str(root),
            allowed="a folder of folders with a campaign.toml",
            next_step="correct source.path",
        )
    names: dict[str, Path] = {}
    for folder in folders:
        name = declared_id(folder)
        if name in names:
            raise ConfigError(
                "two campaigns have the same device id",
                value=name,
                allowed="one campaign per device",
                next_step=f"change [device] id in {names[name].name} or {folder.name}",
            )
        names[name] = folder
    return RunPlan(config, len(folders), blocks_of(config, len(folders)), folders)


def new_run_id(seed: int) -> str:
    """A run id that sorts by time."""
    return f"{datetime.now(UTC):%Y%m%dT%H%M%S%f}"[:-3] + f"-seed{seed}"


def start(planned: RunPlan, results: Path) -> RunStore:
    """Create the folder of a new run below ``results``."""
    seed = planned.config.run.seed
    toml = tomli_w.dumps(without_none(to_toml_table(planned.config)))
    return create_run(results, new_run_id(seed), toml, provenance(seed))


def without_none(table: Mapping[str, Any]) -> dict[str, Any]:
    """``table`` without keys whose value is ``None``: TOML has no null, and an absent key means the default."""
    out: dict[str, Any] = {}
    for key, value in table.items():
        if value is None:
            continue
        out[key] = without_none(value) if isinstance(value, Mapping) else value
    return out


def resume(results: Path, run_id: str) -> tuple[RunPlan, RunStore]:
    """The plan and the folder of a run that stopped, from its own run.toml; ``run_id`` may be "latest".

    Raises
    ------
    UsageError : there is no such run.
    ConfigError : its run.toml was edited and can no longer be used.
    """
    store = open_run(results, None if run_id == "latest" else run_id)
    before, now = store.manifest.provenance, provenance(0)
    changed = [key for key in ("versions", "simd", "python") if before.get(key) != now[key]]
    if changed:
        store.log({"event": "resumed elsewhere", "changed": changed})
        print(
            f"warning: {', '.join(changed)} changed since the run started; the last digits of its table may differ",
            file=sys.stderr,
        )
    config = config_of_run(store.config_toml, f"run.toml of {store.run_id}")
    return plan(config), store
