"""Read runs; every file is checked against the SHA-256 in the manifest first."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import pyarrow as pa

from ..errors import IntegrityError, UsageError
from .files import sha256
from .folders import PREFIX, run_folders
from .irregularity_table import schema_of
from .journal import read_manifest
from .manifest import NAME as MANIFEST
from .manifest import FileEntry, Kind, Manifest
from .parquet import decode_table

CONFIG = "run.toml"
#: The name of the newest run.
LATEST = "latest"
#: How often a reader starts again because a writer replaced files while it read.
_TRIES = 20
_DAMAGED = "run `gyroscreen verify` for the whole list; restore the file from a copy, or run again"
T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class RunTables:
    """A run, verified: its tables in block order, manifest and configuration."""

    devices: pa.Table
    posterior: pa.Table
    manifest: Manifest
    config_toml: str


def list_runs(results: Path) -> tuple[Manifest, ...]:
    """Manifests of all runs, oldest first; empty if there are none.

    Raises
    ------
    IntegrityError : a manifest is damaged (leaving out that run silently would falsify yields).
    """
    return tuple(
        sorted((read_manifest(folder) for folder in run_folders(results)), key=lambda m: (m.created, m.run_id))
    )


def find_run(results: Path, run_id: str | None = None) -> Path:
    """Folder of a run; without a name, and as "latest", of the newest.

    Raises
    ------
    UsageError : there is no such run, or none at all.
    IntegrityError : a manifest is damaged, so the newest run is not known.
    """
    folders = run_folders(results)
    if not folders:
        raise UsageError(
            "the results folder holds no runs",
            value=str(results),
            next_step="make one with `gyroscreen run`, or name the folder with --results",
        )
    if run_id in (None, LATEST):
        return results / f"{PREFIX}{list_runs(results)[-1].run_id}"
    folder = results / f"{PREFIX}{run_id}"
    if folder not in folders:
        known = [path.name.removeprefix(PREFIX) for path in folders]
        raise UsageError(
            "there is no such run",
            value=run_id,
            allowed=", ".join(known[-10:]),
            next_step='`gyroscreen query "SELECT run_id, created, status FROM runs"` lists them',
        )
    return folder


def settled(folder: Path, read: Callable[[Manifest], T]) -> T:
    """``read(manifest)`` of a run; repeated with the new manifest where a writer replaced files in between.

    Raises
    ------
    IntegrityError : something is not what was committed.
    """
    for _ in range(_TRIES):
        manifest = read_manifest(folder)
        try:
            return read(manifest)
        except IntegrityError:
            if read_manifest(folder) == manifest:
                raise
    return read(read_manifest(folder))


def read_file(folder: Path, entry: FileEntry) -> bytes:
    """Bytes of a committed file.

    Raises
    ------
    IntegrityError : it is missing, unreadable, or its size or SHA-256 is not what was committed.
    """
    path = folder / entry.name
    try:
        data = path.read_bytes()
    except OSError as error:
        raise _unreadable(path, error) from None
    _require_committed(path, entry, sha256(data), len(data))
    return data


def check_file(folder: Path, entry: FileEntry) -> None:
    """The check of :func:`read_file` for a file that is not needed whole: parts of it are in memory, one after the other."""
    path = folder / entry.name
    try:
        with path.open("rb", buffering=0) as file:
            digest = hashlib.file_digest(file, "sha256")
            size = file.tell()
    except OSError as error:
        raise _unreadable(path, error) from None
    _require_committed(path, entry, digest.hexdigest(), size)


def _unreadable(path: Path, error: OSError) -> IntegrityError:
    return IntegrityError(f"{path} was committed and cannot be read ({error.strerror})", next_step=_DAMAGED)


def _require_committed(path: Path, entry: FileEntry, found: str, size: int) -> None:
    if found not in (entry.sha256, entry.next_sha256):
        raise IntegrityError(
            f"{path} is not what was committed",
            value=f"{size} bytes, sha256 {found}",
            allowed=f"{entry.bytes} bytes, sha256 {entry.sha256}",
            next_step=_DAMAGED,
        )


def read_config(folder: Path, manifest: Manifest) -> str:
    """``run.toml`` as it was committed; IntegrityError otherwise."""
    entries = manifest.of_kind("config")
    if len(entries) != 1:
        raise IntegrityError(f"{folder / MANIFEST} lists no {CONFIG}", next_step="restore the run from a copy")
    return read_file(folder, entries[0]).decode()


def read_block(folder: Path, entry: FileEntry) -> pa.Table:
    """One block of a table in the registered schema; raises as :func:`read_table`."""
    table = decode_table(read_file(folder, entry), schema_of(entry.kind), str(folder / entry.name))
    if table.num_rows != entry.rows:
        raise IntegrityError(
            f"{folder / entry.name} has the wrong number of rows",
            value=table.num_rows,
            allowed=str(entry.rows),
            next_step="run `gyroscreen verify`",
        )
    return table


def read_table(folder: Path, manifest: Manifest, kind: Kind) -> pa.Table:
    """All blocks of one table in the registered schema, in block order; empty where nothing was committed.

    Raises
    ------
    IntegrityError : a file is not what was committed, or holds another number of rows.
    """
    blocks = [schema_of(kind).empty_table(), *(read_block(folder, entry) for entry in manifest.of_kind(kind))]
    return pa.concat_tables(blocks).combine_chunks()


def read_run(results: Path, run_id: str | None = None) -> RunTables:
    """Read a run, verifying every byte of its tables and configuration; an unfinished run gives its committed part.

    Parameters
    ----------
    results : folder of all runs.
    run_id : name of the run; ``None`` is the newest.

    Raises
    ------
    UsageError : there is no such run.
    IntegrityError : something is not what was committed.
    """
    folder = find_run(results, run_id)
    return settled(
        folder,
        lambda manifest: RunTables(
            devices=read_table(folder, manifest, "devices"),
            posterior=read_table(folder, manifest, "posterior"),
            manifest=manifest,
            config_toml=read_config(folder, manifest),
        ),
    )
