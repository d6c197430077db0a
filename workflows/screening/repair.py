"""`verify --repair`: damaged tables are computed again from the run's own inputs, and must be what was committed.

    damaged file -> damaged/ ;  blocks of the file -> [workers] -> (amended) table -> same SHA-256 as committed? -> file

A table of another hash is not stored: then versions or processor differ from those of the run, or an input has gone.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa
from distributed import Client

from pipeline.errors import GyroscreenError, IntegrityError
from pipeline.store import log
from pipeline.store.block import amended
from pipeline.store.folders import PREFIX, run_folders
from pipeline.store.journal import read_manifest
from pipeline.store.lock import one_writer
from pipeline.store.manifest import FileEntry, Manifest
from pipeline.store.parquet import encode_table
from pipeline.store.read import read_block
from pipeline.store.repair import cut_journal, put_aside, restore_file, restore_log
from pipeline.store.run import RunStore
from pipeline.store.verify import verify_run
from reports.run.lot_effects import FILE as EFFECTS

from ..config import config_of_run
from ..process import worker_count
from .block import BlockTables
from .cluster import cluster
from .dispatch import guarded_in_parallel
from .inputs import FILE as INPUTS
from .inputs import with_records
from .outcome import write_report
from .parts import BLOCK_FAULTS, Assembly, BlockItem, block_items, block_task
from .plan import RunPlan, plan, resume

REPORT = "report.html"


@dataclass(frozen=True)
class RepairStep:
    """A damaged file, what was done about it, and whether it is sound again."""

    file: str
    what: str
    done: bool

    def __str__(self) -> str:
        return f"{'repaired' if self.done else 'not repaired'}: {self.file}: {self.what}"


def repair(results: Path, workers: int = 0, quiet: bool = True) -> tuple[RepairStep, ...]:
    """Repair what can be repaired in all runs of a folder.

    Raises
    ------
    UsageError : another process works on a damaged run.
    """
    steps: list[RepairStep] = []
    for folder in run_folders(results):
        if not verify_run(folder).ok:
            with one_writer(folder):
                steps += _run_repaired(results, folder, workers, quiet)
    return tuple(steps)


def _run_repaired(results: Path, folder: Path, workers: int, quiet: bool) -> Iterator[RepairStep]:
    try:
        read_manifest(folder)
    except IntegrityError as error:
        try:
            yield RepairStep(str(folder), f"journal: {cut_journal(folder)}", True)
        except (IntegrityError, OSError):
            yield RepairStep(str(folder), f"{error.what}; restore the file from a copy", False)
            return
    manifest = read_manifest(folder)
    names = {Path(finding.file).name for finding in verify_run(folder).errors}
    entries = [entry for entry in manifest.files if entry.name in names]
    if log.NAME in names:
        yield RepairStep(str(folder / log.NAME), restore_log(folder), True)
    for entry in entries:
        if entry.name == INPUTS:
            yield _inputs_repaired(folder, entry)
        elif entry.kind in ("config", "page") and entry.name not in (EFFECTS, REPORT):
            yield RepairStep(str(folder / entry.name), "nothing else holds its content; restore it from a copy", False)
    damaged = [
        entry for entry in entries if entry.kind in ("devices", "posterior", "irregularities") or entry.name == EFFECTS
    ]
    if damaged:
        try:
            yield from _tables_repaired(results, folder, manifest, damaged, workers, quiet)
        except GyroscreenError as error:
            yield from (
                RepairStep(str(folder / entry.name), f"cannot be computed again: {error}", False) for entry in damaged
            )
    if REPORT in names:
        try:
            put_aside(folder, REPORT)
            write_report(results, folder.name.removeprefix(PREFIX))
            yield RepairStep(str(folder / REPORT), "written again from the results", True)
        except GyroscreenError as error:
            yield RepairStep(str(folder / REPORT), f"cannot be written again: {error}", False)


def _inputs_repaired(folder: Path, entry: FileEntry) -> RepairStep:
    """The copies of the inputs from the files themselves, if these have not changed since."""
    path = str(folder / entry.name)
    try:
        config = config_of_run(RunStore(folder).config_toml, f"run.toml of {folder.name}")
        if restore_file(folder, entry, with_records(plan(config).inputs).to_json()):
            return RepairStep(path, "copied again from the input files, which have not changed", True)
    except GyroscreenError as error:
        return RepairStep(path, f"the input files cannot be copied again: {error}", False)
    return RepairStep(path, "the input files have changed since; restore it from a copy", False)


def _tables_repaired(
    results: Path, folder: Path, manifest: Manifest, damaged: Sequence[FileEntry], workers: int, quiet: bool
) -> Iterator[RepairStep]:
    planned, store = resume(results, folder.name.removeprefix(PREFIX))
    indices = {index for entry in damaged if entry.kind != "page" for index in entry.span()}
    with cluster(worker_count(workers or planned.config.run.workers), None) as client:
        blocks = _computed(planned, folder, sorted(indices), client)
        left = []
        for entry in damaged:
            if entry.kind != "page" and restore_file(folder, entry, _encoded(_rows(entry, blocks))):
                yield RepairStep(str(folder / entry.name), _done(entry), True)
            else:
                left.append(entry)
        if not left:
            return
        examined = any(entry.name == EFFECTS for entry in manifest.files)
        if examined:  # the columns that the examination added are part of the tables
            from .lot.run import examination

            whole = pa.concat_tables(
                [_rows(e, blocks) if e in left else read_block(folder, e) for e in manifest.of_kind("devices")]
            )
            found, columns = examination(planned, store, whole, client, quiet)
    for entry in left:
        data: bytes | memoryview = b""
        if examined and entry.name == EFFECTS:
            data = found.to_json()
        elif examined and entry.kind == "devices":
            data = _encoded(amended(_rows(entry, blocks), columns))
        if restore_file(folder, entry, data):
            yield RepairStep(str(folder / entry.name), _done(entry), True)
        else:
            yield RepairStep(
                str(folder / entry.name),
                "computed again, but not equal to what was committed (other versions?); left",
                False,
            )


def _done(entry: FileEntry) -> str:
    what = "" if entry.block is None else f" ({entry.rows} rows of {len(entry.span())} blocks)"
    return f"computed again{what}; equal to what was committed, byte by byte"


def _encoded(table: pa.Table) -> memoryview:
    return memoryview(encode_table(table))


def _rows(entry: FileEntry, blocks: dict[int, BlockTables]) -> pa.Table:
    """The table of a file from those of its blocks."""
    own = [blocks[index] for index in entry.span() if index in blocks]
    tables = [getattr(block, entry.kind) for block in own]  # a block has a field for each kind of table
    return pa.concat_tables([table for table in tables if table is not None])


def _computed(planned: RunPlan, folder: Path, indices: Sequence[int], client: Client) -> dict[int, BlockTables]:
    """The blocks by number, computed again; devices that were given up in the run stay given up."""
    wanted = [planned.blocks[index] for index in indices]
    lost = _lost(folder)
    items: list[BlockItem] = []
    for item in block_items(wanted, planned.campaigns):
        for number in BLOCK_FAULTS.devices(item):
            part = BLOCK_FAULTS.part(item, range(number, number + 1))
            if number in lost:
                items.append(BLOCK_FAULTS.lost(part, lost[number]))
            else:
                items.append(part)
    whole = Assembly({block.index: block for block in wanted})
    found: dict[int, BlockTables] = {}
    limit_s = planned.config.run.device_limit_s
    for item, done in guarded_in_parallel(client, block_task, planned.config, items, BLOCK_FAULTS, limit_s):
        tables = whole.add(item.block, done)
        if tables is not None:
            found[tables.index] = tables
    return found


def _lost(folder: Path) -> dict[int, str]:
    """Numbers of the devices that the run gave up, with the reason, from its log."""
    found: dict[int, str] = {}
    with suppress(OSError):
        for line in (folder / log.NAME).read_bytes().splitlines():
            if b'"event":"lost"' in line and log.sound(line):
                event = json.loads(line)
                found |= dict.fromkeys(event["devices"], event["reason"])
    return found
