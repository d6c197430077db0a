"""The nightly batch: blocks in parallel, each committed as it comes; then the report.

configuration -> blocks -> [dask: draw or read, chirp, identify, judge] -> commit -> finish -> report.html
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import tomli_w
from distributed import Client

from pipeline.errors import ConfigError, GateError, IncompleteError
from pipeline.store.provenance import provenance
from pipeline.store.read import read_run
from pipeline.store.run import RunStore, create_run, open_run
from reports.run import lot_effects as lot_report
from reports.run.page import render_run_report
from reports.yields import yield_of_verdicts

from ..config import RunConfig, config_of_run, to_toml_table
from ..machine import worker_count
from .block import (
    BlockTables,
    DeviceBlock,
    blocks_of,
    campaign_folders,
    declared_id,
    physics_of,
    population,
    shared_record,
    virtual_block,
)
from .campaign_block import campaign_block
from .cluster import cluster, in_parallel
from .lot.device import DeviceExamination, Request, examine_device
from .lot.effects import examine
from .progress import progress


@dataclass(frozen=True)
class RunResult:
    """What a run left: where, how many devices by verdict and status, the yield with its interval, how long it took."""

    run_id: str
    folder: Path
    devices: int
    verdicts: dict[str, int]
    statuses: dict[str, int]
    yield_share: float
    yield_interval: tuple[float, float]
    lot_effects: tuple[str, ...]
    main_cause: str | None
    seconds: float
    report: Path | None

    def to_dict(self) -> dict[str, Any]:
        """Plain data for JSON."""
        return {
            "run_id": self.run_id,
            "folder": str(self.folder),
            "devices": self.devices,
            "verdicts": self.verdicts,
            "statuses": self.statuses,
            "yield": self.yield_share,
            "yield_interval": list(self.yield_interval),
            "lot_effects": list(self.lot_effects),
            "main_cause": self.main_cause,
            "seconds": round(self.seconds, 3),
            "report": None if self.report is None else str(self.report),
        }


@dataclass(frozen=True, eq=False)
class RunPlan:
    """A run that is laid out but not run: configuration, devices and blocks."""

    config: RunConfig
    devices: int
    blocks: tuple[DeviceBlock, ...]
    folders: tuple[Path, ...]


def plan(config: RunConfig) -> RunPlan:
    """Lay a run out; everything that can be wrong before the first device is found here.

    Raises
    ------
    ConfigError : population, limits or campaigns cannot be used.
    """
    if config.source.kind == "population":
        population(config)
        physics_of(config)
        shared_record(config)
        return RunPlan(config, config.run.devices, blocks_of(config, config.run.devices), ())
    root = Path(config.source.path or ".")
    folders = campaign_folders(root)
    if not folders:
        raise ConfigError(
            "no campaign below this folder",
            value=str(root),
            allowed="folders that hold a campaign.toml",
            next_step="check [source] path",
        )
    names: dict[str, Path] = {}
    for folder in folders:
        name = declared_id(folder)
        if name in names:
            raise ConfigError(
                "two campaigns of one device id",
                value=name,
                allowed="one campaign a device",
                next_step=f"change [device] id in {names[name].name} or {folder.name}",
            )
        names[name] = folder
    return RunPlan(config, len(folders), blocks_of(config, len(folders)), folders)


def new_run_id(seed: int) -> str:
    """A name that sorts by time."""
    return f"{datetime.now(UTC):%Y%m%dT%H%M%S%f}"[:-3] + f"-seed{seed}"


def start(night: RunPlan, results: Path) -> RunStore:
    """Create the folder of the run."""
    table = to_toml_table(night.config)
    toml = tomli_w.dumps(without_none(table))
    return create_run(results, new_run_id(night.config.run.seed), toml, provenance(night.config.run.seed))


def without_none(table: Mapping[str, Any]) -> dict[str, Any]:
    """``table`` without its nulls: TOML has none, and an absent key is the default."""
    out: dict[str, Any] = {}
    for key, value in table.items():
        if value is None:
            continue
        out[key] = without_none(value) if isinstance(value, Mapping) else value
    return out


def resume(results: Path, run_id: str) -> tuple[RunPlan, RunStore]:
    """The night of a run that stopped, from its own run.toml."""
    store = open_run(results, None if run_id == "latest" else run_id)
    before, now = store.manifest.provenance, provenance(0)
    changed = [key for key in ("versions", "simd", "python") if before.get(key) != now[key]]
    if changed:
        store.log({"event": "resumed elsewhere", "changed": changed})
        print(
            f"warning: {', '.join(changed)} differ from when the run began; its table may differ in the last digits",
            file=sys.stderr,
        )
    config = config_of_run(store.config_toml, f"run.toml of {store.run_id}")
    return plan(config), store


def block_task(night: tuple[RunConfig, tuple[Path, ...]], block: DeviceBlock) -> BlockTables:
    """One block, wherever its devices come from (runs in a worker)."""
    config, folders = night
    if config.source.kind == "population":
        return virtual_block(config, block)
    return campaign_block(config, block, folders[block.first : block.first + block.count])


def run_blocks(night: RunPlan, store: RunStore, workers: int, scheduler: str | None, quiet: bool) -> None:
    """Run all blocks that are not committed yet, committing each as it comes."""
    done = store.committed_blocks()
    left = [block for block in night.blocks if block.index not in done]
    examined = not night.config.diagnosis.enabled or store.page(lot_report.FILE) is not None
    if not left and examined:
        return
    finished = night.devices - sum(block.count for block in left)
    count = worker_count(workers or night.config.run.workers)
    count = min(count, len(left)) if examined else count
    store.log({"event": "start", "workers": count, "scheduler": scheduler, "blocks": len(left)})
    with cluster(count, scheduler) as client, progress(night.devices, finished, quiet) as advance:
        for tables in in_parallel(client, block_task, (night.config, night.folders), left):
            store.commit_block(tables.index, tables.devices, tables.posterior)
            store.log({"event": "block", "block": tables.index, "statuses": tables.statuses})
            advance(tables.devices.num_rows)
        if not examined:
            _examine(night, store, client, quiet)


def _examine(night: RunPlan, store: RunStore, client: Client, quiet: bool) -> None:
    """Find out what misfits lack, write it into their rows, and leave the findings beside the tables."""

    def look(requests: Sequence[Request]) -> Iterator[DeviceExamination]:
        store.log({"event": "look", "devices": len(requests)})
        with progress(len(requests), 0, quiet, "examining") as advance:
            for seen in in_parallel(client, examine_device, (night.config, night.folders), requests):
                advance(1)
                yield seen

    found, columns = examine(store.devices(), night.config.diagnosis, look)
    store.amend_devices(columns)
    store.write_file(lot_report.FILE, found.to_json())
    store.log({"event": "examined", "effects": [effect.effect for effect in found.effects]})


def write_report(results: Path, run_id: str) -> tuple[str, Path]:
    """Render the report of a run and store it beside its tables; returns the page and its path."""
    tables = read_run(results, run_id)
    config = config_of_run(tables.config_toml, f"run.toml of {run_id}")
    said = dict(population(config).assumptions()) if config.source.kind == "population" else None
    store = open_run(results, run_id)
    found = lot_effects(store)
    page = render_run_report(tables, config.judged_by(), population_summary=said, lot_effects=found)
    store.write_file("report.html", page.encode("utf-8"))
    return page, store.folder / "report.html"


def lot_effects(store: RunStore) -> lot_report.LotEffects | None:
    """What a run found of its misfits; ``None`` where they were not examined."""
    data = store.page(lot_report.FILE)
    return None if data is None else lot_report.LotEffects.from_json(data)


def finish(night: RunPlan, store: RunStore, results: Path, started: float) -> RunResult:
    """Close the run, write the report and say what came out."""
    tables = read_run(results, store.run_id)
    devices = tables.devices
    verdicts = _counts(devices.column("verdict").to_pylist(), ("pass", "fail", "undecided"))
    statuses = _counts(devices.column("status").to_pylist(), ("ok", "not_converged", "misfit", "fit_failed"))
    found = yield_of_verdicts([str(v) for v in devices.column("verdict").to_pylist()])
    causes = _counts(
        [c for cell in devices.column("failed_limits").to_pylist() if cell for c in str(cell).split(",")], ()
    )
    main = max(causes, key=lambda name: causes[name]) if causes else None
    interval = (found.clopper_pearson.low, found.clopper_pearson.high)
    seconds = time.monotonic() - started
    said = lot_effects(store)
    needed = () if said is None else tuple(sorted({effect.effect for effect in said.effects}))
    summary = {"verdicts": verdicts, "statuses": statuses, "lot_effects": list(needed), "seconds": round(seconds, 3)}
    store.finish("complete", summary)
    _, path = write_report(results, store.run_id)
    store.log({"event": "finish", "verdicts": verdicts, "statuses": statuses})
    return RunResult(
        store.run_id,
        store.folder,
        devices.num_rows,
        verdicts,
        statuses,
        verdicts["pass"] / max(devices.num_rows, 1),
        interval,
        needed,
        main,
        time.monotonic() - started,
        path,
    )


def _counts(values: list[Any], always: tuple[str, ...]) -> dict[str, int]:
    out = dict.fromkeys(always, 0)
    for value in values:
        out[str(value)] = out.get(str(value), 0) + 1
    return out


def check_targets(night: RunPlan, result: RunResult) -> None:
    """The gates that the user set on the whole run.

    Raises
    ------
    GateError : the yield is below [targets] yield_min, or a device did not converge under strict_convergence.
    """
    targets = night.config.targets
    if targets.yield_min is not None and result.yield_share < targets.yield_min:
        raise GateError(
            "yield below target",
            value=round(result.yield_share, 4),
            allowed=f"at least {targets.yield_min:g}",
            next_step=f"see {result.report}",
        )
    lost = result.statuses["not_converged"] + result.statuses["fit_failed"]
    if targets.strict_convergence and lost:
        raise GateError(
            "devices without a converged posterior",
            value=lost,
            allowed="none under strict_convergence",
            next_step="gyroscreen query \"SELECT device_id, status_reason FROM devices WHERE status <> 'ok'\"",
        )


def run_batch(
    night: RunPlan,
    store: RunStore,
    results: Path,
    workers: int = 0,
    scheduler: str | None = None,
    quiet: bool = True,
    on_interrupt: Callable[[], None] = lambda: None,
) -> RunResult:
    """Run (or go on with) a night to its report.

    Raises
    ------
    IncompleteError : it stopped before its end; what is committed is kept.
    KeyboardInterrupt : after the run was marked as stopped.
    """
    started = time.monotonic()
    try:
        run_blocks(night, store, workers, scheduler, quiet)
    except (KeyboardInterrupt, IncompleteError):
        store.log({"event": "stopped"})
        if store.committed_blocks():
            store.finish("stopped", {})
        on_interrupt()
        raise
    return finish(night, store, results, started)


__all__ = ["RunPlan", "RunResult", "check_targets", "plan", "resume", "run_batch", "start", "write_report"]
