"""A run whose tables stay on disk and are read column by column: a report of 10^7 devices holds a few columns at a time.

Every file is checked against its SHA-256 when the run is opened, and its pages against their checksums whenever they are read.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.dataset as ds
from pyarrow.fs import LocalFileSystem

from ..errors import IntegrityError
from .manifest import Kind, Manifest
from .read import find_run, read_config, read_file, settled
from .schema import devices_schema, posterior_schema

#: Columns that were read are kept up to this size together.
_KEPT_BYTES = 128 << 20
T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class StoredTable:
    """A committed table in the registered schema; offers what reports use of a ``pyarrow.Table``.

    Raises
    ------
    IntegrityError : by every method, where a file is not what was committed.
    """

    dataset: ds.Dataset
    num_rows: int
    column_names: tuple[str, ...]
    _kept: OrderedDict[str, pa.ChunkedArray] = field(default_factory=OrderedDict, repr=False)

    def __getitem__(self, name: str) -> pa.ChunkedArray:
        """A column, whole."""
        if name not in self._kept:
            self._kept[name] = _read(lambda: self.dataset.to_table(columns=[name]).column(0))
        self._kept.move_to_end(name)
        found = self._kept[name]
        while len(self._kept) > 1 and sum(column.nbytes for column in self._kept.values()) > _KEPT_BYTES:
            self._kept.popitem(last=False)
        return found

    def slice(self, offset: int, length: int) -> pa.Table:
        """Rows from ``offset`` on, with all columns."""
        return _read(lambda: self.dataset.take(range(offset, offset + length)))

    def filter(self, wanted: pc.Expression) -> pa.Table:
        """The rows that fulfil an expression, with all columns."""
        return _read(lambda: self.dataset.to_table(filter=wanted))

    def select(self, names: Sequence[str]) -> StoredTable:
        """The table with these columns alone."""
        return StoredTable(self.dataset, self.num_rows, tuple(names))

    def to_batches(self) -> Iterator[pa.RecordBatch]:
        """The rows in parts, in order; few are in memory at a time."""
        batches = self.dataset.to_batches(columns=list(self.column_names), batch_readahead=1, fragment_readahead=1)
        while True:
            batch = _read(lambda: next(batches, None))
            if batch is None:
                return
            yield batch


@dataclass(frozen=True, eq=False)
class StoredRun:
    """A run, verified: its tables on disk, manifest and configuration."""

    devices: StoredTable
    posterior: StoredTable
    manifest: Manifest
    config_toml: str


def with_run(results: Path, run_id: str | None, use: Callable[[StoredRun], T]) -> T:
    """``use(run)``; repeated where a writer replaced files of the run in between.

    Raises
    ------
    UsageError : there is no such run.
    IntegrityError : a file is not what was committed.
    """
    folder = find_run(results, run_id)

    def opened(manifest: Manifest) -> T:
        config = read_config(folder, manifest)
        return use(
            StoredRun(_table(folder, manifest, "devices"), _table(folder, manifest, "posterior"), manifest, config)
        )

    return settled(folder, opened)


def _table(folder: Path, manifest: Manifest, kind: Kind) -> StoredTable:
    entries = manifest.of_kind(kind)
    for entry in entries:
        read_file(folder, entry)
    schema = devices_schema() if kind == "devices" else posterior_schema()
    checked = ds.ParquetFragmentScanOptions(page_checksum_verification=True)
    dataset = ds.FileSystemDataset.from_paths(
        [str((folder / entry.name).resolve()) for entry in entries],
        schema=schema,
        format=ds.ParquetFileFormat(default_fragment_scan_options=checked),
        filesystem=LocalFileSystem(),
    )
    return StoredTable(dataset, manifest.rows(kind), tuple(schema.names))


def _read(read: Callable[[], T]) -> T:
    try:
        return read()
    except (pa.ArrowException, OSError) as error:
        raise IntegrityError(
            f"results cannot be read ({str(error).splitlines()[0]})", next_step="run `gyroscreen verify`"
        ) from None
