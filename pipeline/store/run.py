"""A run on disk: created once, filled block by block, finished.

    DIR/run=<run_id>/  devices-00000.parquet  posterior-00000.parquet  manifest.json  run.toml  log.jsonl
    report.html

Commit of a block: stage, fsync, rename the tables; then append a line that lists them with their SHA-256 to the journal
and fsync it. At checkpoints and at the end manifest.json is written by rename and takes over the journal, and small block files
are merged (see checkpoint.py). Manifest and journal decide: a table that they do not list is not part of the run.
Long because every way of writing to a run follows the same commit protocol and shares its lock.
"""

from __future__ import annotations

import re
import secrets
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, Literal

import pyarrow as pa

from ..errors import ConfigError, IncompleteError, IntegrityError, UsageError
from . import files, log
from .block import amended, block_file, check_block, other_name
from .checkpoint import checkpoint, encoded, put_manifest, sweep
from .folders import PREFIX, check_results
from .journal import Journal, read_manifest
from .manifest import NAME as MANIFEST
from .manifest import FileEntry, Kind, Manifest
from .parquet import encode_table
from .read import CONFIG, find_run, list_runs, read_block, read_config, read_file, read_table, settled
from .stream import streamed

RUN_ID = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}")
PAGE = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*\.(html|json|svg|png|csv|toml|txt)")


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="milliseconds")


@dataclass(frozen=True)
class RunStore:
    """A run's folder, open for writing; every answer comes from the manifest and the journal on disk.

    ``journal`` only saves reading again what has not changed.
    Any number of processes may hold one; writes wait for each other.
    """

    folder: Path
    journal: Journal = field(default_factory=Journal, repr=False, compare=False)

    @property
    def run_id(self) -> str:
        """Name of the run."""
        return self.folder.name.removeprefix(PREFIX)

    @property
    def manifest(self) -> Manifest:
        """The manifest as it is now; IntegrityError if it is damaged."""
        return read_manifest(self.folder)

    @property
    def config_toml(self) -> str:
        """``run.toml`` as it was given at creation; IntegrityError if it has changed."""
        return read_config(self.folder, self.manifest)

    def committed_blocks(self) -> frozenset[int]:
        """Numbers of the committed blocks."""
        return self.manifest.blocks()

    def devices(self) -> pa.Table:
        """The committed ``devices`` in block order; IntegrityError where one is not what was committed."""
        return settled(self.folder, lambda manifest: read_table(self.folder, manifest, "devices"))

    def page(self, name: str) -> bytes | None:
        """A page of the run as it was written, or ``None`` where there is none; IntegrityError if it has changed."""

        def read(manifest: Manifest) -> bytes | None:
            entry = next((entry for entry in manifest.of_kind("page") if entry.name == name), None)
            return None if entry is None else read_file(self.folder, entry)

        return settled(self.folder, read)

    def commit_block(
        self, block: int, devices: pa.Table, posterior: pa.Table | None, irregularities: pa.Table | None = None
    ) -> None:
        """Commit the tables of one block, atomically; a block that is already committed is left unchanged.

        Parameters
        ----------
        block : number of the block, from 0; tables are read back in this order.
        devices : ``devices`` in the registered schema, one row a device.
        posterior : ``posterior`` in the registered schema, or ``None`` where draws are not kept.
        irregularities : likewise, of the numbers that its virtual devices were drawn with.

        Raises
        ------
        UsageError : a negative block, or the run is complete and has no such block.
        IntegrityError : a table is not in the registered schema, or a device occurs twice in the block.
        IncompleteError : writing failed; earlier commits are kept.
        """
        if block < 0:
            raise UsageError("a block has a number from 0", value=block)
        given: dict[Kind, pa.Table | None] = {
            "devices": devices,
            "posterior": posterior,
            "irregularities": irregularities,
        }
        tables = {kind: table for kind, table in given.items() if table is not None}
        check_block(block, tables)
        with self._writing(clean=self.journal.lines == 0):
            self.journal.refresh(self.folder)
            if block in self.journal.blocks:
                return
            if self.journal.status == "complete":
                raise UsageError(
                    f"run {self.run_id} is complete and accepts no further blocks",
                    value=block,
                    next_step="start a new run",
                )
            entries = []
            for kind, table in tables.items():
                data = memoryview(encode_table(table))
                name = block_file(kind, block)
                files.stage(self.folder, name, data)
                entries.append(FileEntry(name, kind, data.nbytes, files.sha256(data), block=block, rows=table.num_rows))
            for entry in entries:
                files.publish(self.folder, entry.name)
            files.fsync_folder(self.folder)
            self.journal.append(self.folder, entries)
            if self.journal.long:
                checkpoint(self.folder, self.manifest)

    def amend_devices(self, values: Mapping[str, Mapping[str, Any]]) -> None:
        """Set columns of single devices in committed blocks, atomically: all, or none if the process dies.

        Parameters
        ----------
        values : device_id -> column -> value, in the registered schema; other columns stay as they are.

        Raises
        ------
        UsageError : a column that is not registered, or a value of the wrong type.
        IncompleteError : writing failed; the run is unchanged.
        """
        with self._writing():
            manifest = self.manifest
            now = [_amended(self.folder, entry, values) for entry in manifest.of_kind("devices")]
            if now == list(manifest.of_kind("devices")):
                return
            files.fsync_folder(self.folder)
            others = tuple(entry for entry in manifest.files if entry.kind != "devices")
            put_manifest(self.folder, replace(manifest, files=(*others, *now), devices_digest=None))
            sweep(self.folder)

    def write_file(self, name: str, data: bytes) -> None:
        """Write or replace a page of the run (report.html) and record it in the manifest.

        Raises
        ------
        UsageError : not a plain file name, or a reserved one.
        IncompleteError : writing failed.
        """
        if not PAGE.fullmatch(name) or name in (MANIFEST, CONFIG):
            raise UsageError("not the name of a page of a run", value=name, allowed="for instance report.html")
        with self._writing():
            manifest = self.manifest
            others = tuple(entry for entry in manifest.files if entry.name != name)
            before = next((entry for entry in manifest.files if entry.name == name), None)
            if before is not None:
                # Readers find the old page or the new one until the manifest lists the new one alone.
                either = replace(self._page_on_disk(before), next_sha256=files.sha256(data))
                put_manifest(self.folder, replace(manifest, files=(*others, either)))
            files.replace_file(self.folder, name, data)
            entry = FileEntry(name, "page", len(data), files.sha256(data))
            put_manifest(self.folder, replace(manifest, files=(*others, entry)))

    def _page_on_disk(self, entry: FileEntry) -> FileEntry:
        """The entry of a page whose replacement was interrupted: that of the new page where it had already taken its place."""
        path = self.folder / entry.name
        if not entry.next_sha256 or not path.is_file():
            return entry
        data = path.read_bytes()
        found = files.sha256(data)
        return FileEntry(entry.name, "page", len(data), found) if found == entry.next_sha256 else entry

    def finish(self, status: Literal["complete", "stopped"], summary: Mapping[str, Any]) -> None:
        """Close the run: store the digest of the whole ``devices`` table, the summary and the time.

        Raises
        ------
        IncompleteError : "complete" although blocks are missing between the first and the last.
        IntegrityError : committed tables cannot be read back, or a device occurs twice.
        UsageError : the summary is not JSON.
        """
        with self._writing():
            manifest = self.manifest
            missing = sorted(set(range(max(manifest.blocks(), default=-1) + 1)) - manifest.blocks())
            if status == "complete" and missing:
                raise IncompleteError(
                    f"run {self.run_id} lacks blocks",
                    value=missing[:10],
                    next_step="resume it: gyroscreen run --resume",
                )
            if status == "complete":
                manifest = checkpoint(self.folder, manifest, rest=True)
            found = streamed(self.folder, manifest)
            if found.twice:
                raise IntegrityError(
                    f"run {self.run_id} lists a device more than once",
                    value=found.twice[:5],
                    allowed="one row a device",
                )
            put_manifest(
                self.folder,
                replace(manifest, status=status, finished=_now(), summary=dict(summary), devices_digest=found.digest),
            )

    def log(self, event: Mapping[str, Any]) -> None:
        """Append one line to ``log.jsonl``, with the time and its hash."""
        with _disk(self.folder):
            log.append(self.folder, event)

    @contextmanager
    def _writing(self, clean: bool = True) -> Iterator[None]:
        with _disk(self.folder), files.writing(self.folder, clean):
            try:
                yield
            except OSError:
                sweep(self.folder)
                raise


def _amended(folder: Path, entry: FileEntry, values: Mapping[str, Mapping[str, Any]]) -> FileEntry:
    """A file with the cells ``values`` replaced, published beside the old one; ``entry`` itself if it has none of them."""
    table = read_block(folder, entry)
    changed = amended(table, values)
    if changed is table:
        return entry
    data = memoryview(encode_table(changed))
    name = other_name(entry)
    files.stage(folder, name, data)
    files.publish(folder, name)
    return replace(entry, name=name, bytes=data.nbytes, sha256=files.sha256(data))


def _later(results: Path) -> str:
    """The time, or a moment after the last run where the clock was set back: a new run is the latest one."""
    with suppress(IntegrityError, ValueError):
        runs = list_runs(results)
        if runs and runs[-1].created >= _now():
            after = datetime.fromisoformat(runs[-1].created) + timedelta(milliseconds=1)
            return after.isoformat(timespec="milliseconds")
    return _now()


def create_run(results: Path, run_id: str, config_toml: str, provenance: Mapping[str, Any]) -> RunStore:
    """Create the folder of a new run atomically.

    Parameters
    ----------
    results : folder of all runs; made if absent.
    run_id : letters, digits, ``.``, ``_``, ``-``.
    config_toml : the resolved configuration, kept as ``run.toml``.
    provenance : see :func:`pipeline.store.provenance.provenance`.

    Raises
    ------
    ConfigError : invalid name, the run exists, or the folder cannot be written.
    UsageError : ``results`` is a URL.
    """
    if not RUN_ID.fullmatch(run_id):
        raise ConfigError("not the name of a run", value=run_id, allowed="up to 100 letters, digits, '.', '_', '-'")
    check_results(results)
    folder = results / f"{PREFIX}{run_id}"
    config = config_toml.encode()
    manifest = Manifest(
        run_id=run_id,
        status="running",
        created=_later(results),
        finished=None,
        config_sha256=files.sha256(config),
        provenance=dict(provenance),
        files=(FileEntry(CONFIG, "config", len(config), files.sha256(config)),),
    )
    nascent = results / f".{PREFIX}{run_id}-{secrets.token_hex(4)}{files.STAGED}"
    try:
        results.mkdir(parents=True, exist_ok=True)
        nascent.mkdir()
    except OSError as error:
        raise ConfigError(
            f"cannot write to the results folder ({error.strerror})",
            value=str(results),
            next_step="give another folder with --out, or fix its permissions",
        ) from None
    try:
        files.replace_file(nascent, CONFIG, config)
        files.replace_file(nascent, MANIFEST, encoded(manifest))
        if folder.exists():
            raise FileExistsError
        nascent.rename(folder)
        files.fsync_folder(results)
    except OSError as error:
        if folder.exists():
            raise ConfigError(
                "a run of that name exists",
                value=run_id,
                next_step=f"resume it (gyroscreen run --resume {run_id}), or choose another name",
            ) from None
        raise ConfigError(f"cannot create the run ({error.strerror})", value=str(folder)) from None
    finally:
        shutil.rmtree(nascent, ignore_errors=True)
    return RunStore(folder)


def discard_run(store: RunStore) -> None:
    """Remove a run that could not start; one with a committed block, or that cannot be removed, is kept."""
    nascent = store.folder.with_name(f".{store.folder.name}-{secrets.token_hex(4)}{files.STAGED}")
    with suppress(OSError):
        if not store.committed_blocks():
            store.folder.rename(nascent)
            shutil.rmtree(nascent, ignore_errors=True)


def open_run(results: Path, run_id: str | None = None) -> RunStore:
    """Open a run to continue it.

    Parameters
    ----------
    results : folder of all runs.
    run_id : name of the run; ``None`` is the newest.

    Raises
    ------
    UsageError : there is no such run, or none at all.
    IntegrityError : its manifest or ``run.toml`` is damaged.
    """
    store = RunStore(find_run(results, run_id))
    _ = store.config_toml
    return store


@contextmanager
def _disk(folder: Path) -> Iterator[None]:
    """Convert errors of the file system into one typed error."""
    try:
        yield
    except OSError as error:
        raise IncompleteError(
            f"cannot write to the run ({error.strerror})",
            value=str(folder),
            next_step="free disk space or fix permissions, then gyroscreen run --resume; committed blocks are kept",
        ) from None
