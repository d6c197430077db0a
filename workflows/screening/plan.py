"""The plan of a run: its configuration, devices and blocks, for a new run or one that continues."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import msgspec
import tomli_w

from pipeline.errors import ConfigError, UsageError
from pipeline.store.provenance import provenance
from pipeline.store.run import RunStore, create_run, open_run
from reports.limits_origin import LimitsOrigin

from ..config import RunConfig, config_of_run, to_toml_table, with_stated_limits
from .band import check_band
from .block import DeviceBlock, blocks_of
from .campaign_source import CampaignSource, campaign_folders, declared_id
from .inputs import FILE as INPUTS
from .inputs import (
    InputFile,
    Inputs,
    check_copies,
    collected,
    differences,
    read_inputs,
    record_paths,
    with_records,
    with_stored_code,
)
from .settings import lot_population, lot_source, population, spec_text
from .virtual_device import shared_record, virtual_model

#: Differences that a message shows.
_SHOWN = 8


@dataclass(frozen=True, eq=False)
class RunPlan:
    """Configuration, number of devices and blocks of a run, the campaigns if the devices are measured, and all inputs."""

    config: RunConfig
    devices: int
    blocks: tuple[DeviceBlock, ...]
    campaigns: tuple[CampaignSource, ...]
    inputs: Inputs


def plan(config: RunConfig) -> RunPlan:
    """The plan of a run; finds every fault that can be found before the first device.

    Raises
    ------
    ConfigError : population, effects, limits or campaigns cannot be used.
    """
    config = with_stated_limits(config)
    if config.source.kind == "population":
        source = msgspec.structs.replace(config.source, spec_toml=spec_text(config.source))
        config = msgspec.structs.replace(config, source=source)
        population(config)
        virtual_model(config)
        shared_record(config)
        check_band(config)
        return RunPlan(config, config.run.devices, blocks_of(config, config.run.devices), (), collected(config, ()))
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
                next_step=f"change [device] id in {names[name].name} or {folder.name}; [conditions] part may name one device",
            )
        names[name] = folder
    if config.lot_origin.enabled:
        origin = msgspec.structs.replace(config.lot_origin, population_toml=spec_text(lot_source(config)))
        config = msgspec.structs.replace(config, lot_origin=origin)
        lot_population(config)
    inputs = collected(config, folders)
    return measured_plan(config, folders, inputs)


def measured_plan(config: RunConfig, folders: Sequence[Path], inputs: Inputs) -> RunPlan:
    """The plan of a run on the campaigns in ``folders``, each with the campaign.toml that is among ``inputs``."""
    hashes = {file.path: file.sha256 for file in inputs.of("record")}
    campaigns = []
    for folder, file in zip(folders, inputs.of("campaign"), strict=True):
        text = inputs.text(file)
        records = [path for path in record_paths(file, text) if path in hashes]
        source = CampaignSource(folder, None if text is None else text.encode(), tuple((r, hashes[r]) for r in records))
        campaigns.append(source)
    return RunPlan(config, len(folders), blocks_of(config, len(folders)), tuple(campaigns), inputs)


def new_run_id(seed: int) -> str:
    """A run id that sorts by time."""
    return f"{datetime.now(UTC):%Y%m%dT%H%M%S%f}"[:-3] + f"-seed{seed}"


def start(planned: RunPlan, results: Path, limits: LimitsOrigin | None = None) -> tuple[RunPlan, RunStore]:
    """The plan with the hashes of its records, and the folder of a new run below ``results``; ``limits``: where they are from."""
    planned = _with_records(planned)
    seed = planned.config.run.seed
    toml = tomli_w.dumps(without_none(to_toml_table(planned.config)), multiline_strings=True)
    recorded = {} if limits is None else {"limits": limits.to_dict()}
    store = create_run(results, new_run_id(seed), toml, provenance(seed, **recorded))
    store.write_file(INPUTS, planned.inputs.to_json())
    return planned, store


def _with_records(planned: RunPlan) -> RunPlan:
    inputs = with_records(planned.inputs)
    if not planned.campaigns:
        return replace(planned, inputs=inputs)
    return measured_plan(planned.config, [source.folder for source in planned.campaigns], inputs)


def without_none(table: Mapping[str, Any]) -> dict[str, Any]:
    """``table`` without keys whose value is ``None``: TOML has no null, and an absent key means the default."""
    out: dict[str, Any] = {}
    for key, value in table.items():
        if value is None:
            continue
        out[key] = without_none(value) if isinstance(value, Mapping) else value
    return out


def config_of(results: Path, run_id: str) -> RunConfig:
    """The configuration of a run, from its run.toml; ``run_id`` may be "latest"; raises as :func:`resume`."""
    store = _resumable(results, run_id)
    return config_of_run(store.config_toml, f"run.toml of {store.run_id}")


def _resumable(results: Path, run_id: str) -> RunStore:
    store = open_run(results, None if run_id == "latest" else run_id)
    if store.page(INPUTS) is None and store.committed_blocks():
        raise UsageError(
            "the run was started by a version of gyroscreen that did not store its inputs, so it cannot be resumed",
            value=store.run_id,
            allowed=f"a run with an {INPUTS}",
            next_step="start a new run; query, report and verify still read this one",
        )
    return store


def resume(results: Path, run_id: str, wanted: RunConfig | None = None) -> tuple[RunPlan, RunStore]:
    """The plan and the folder of a run that stopped, from the inputs that it stored; ``run_id`` may be "latest".

    ``wanted`` is what the user asks for; ``None``: whatever the run was started with.

    Raises
    ------
    UsageError : there is no such run, or an older version started it.
    ConfigError : its run.toml was edited and can no longer be used; a record has changed, or ``wanted`` is something else.
    """
    store = _resumable(results, run_id)
    before, now = store.manifest.provenance, provenance(0)
    elsewhere = [key for key in ("versions", "simd", "python") if before.get(key) != now[key]]
    if elsewhere:
        store.log({"event": "resumed elsewhere", "changed": elsewhere})
        print(
            f"warning: {', '.join(elsewhere)} changed since the run started; the last digits of its table may differ",
            file=sys.stderr,
        )
    config = with_stated_limits(config_of_run(store.config_toml, f"run.toml of {store.run_id}"))
    data = store.page(INPUTS)
    if data is None:  # the run was stopped before it stored them
        planned = _with_records(plan(config))
        store.write_file(INPUTS, planned.inputs.to_json())
        return planned, store
    inputs = read_inputs(data, f"{INPUTS} of {store.run_id}")
    changed = inputs.changed()
    if wanted is not None:
        _require_same(config, plan(wanted), inputs, changed)
    check_copies(inputs, changed)
    for file in changed:
        print(f"warning: {file.path} has changed since the run started; the run uses its own copy", file=sys.stderr)
    used = with_stored_code(config, inputs)
    if used.source.kind == "campaigns":
        folders = [Path(file.path).parent for file in inputs.of("campaign")]
        return measured_plan(used, folders, inputs), store
    return replace(plan(used), inputs=inputs), store


def _require_same(stored: RunConfig, wanted: RunPlan, inputs: Inputs, changed: Sequence[InputFile]) -> None:
    known = {file.path for file in inputs.files}
    found = [
        *differences(stored, wanted.config),
        *(f"{file.what} {file.path} has changed" for file in changed),
        *(f"{file.what} {file.path} is new" for file in wanted.inputs.files if file.path not in known),
    ]
    if found:
        more = f" and {len(found) - _SHOWN} more" if len(found) > _SHOWN else ""
        raise ConfigError(
            f"the run was started with other inputs ({'; '.join(found[:_SHOWN])}{more})",
            allowed="--resume with the inputs that the run was started with, or without CONFIG, --devices and --seed",
            next_step="leave them out to continue with the run's own copies, or start a new run without --resume",
        )
