"""A run whose tables stay on disk and are read column by column: a report of 10^7 devices holds a few columns at a time.

Every file is checked against its SHA-256 when the run is opened, and its pages against their checksums whenever they are read.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeVar

import pyarrow as pa
import pyarrow.parquet as pq

from ..errors import IntegrityError
from .column import joined, rows_equal
from .irregularity_table import schema_of
from .manifest import Kind, Manifest
from .read import check_file, find_run, read_config, settled

#: Columns that were read are kept up to this size together.
_KEPT_BYTES = 192 << 20
#: Files that stay open: a footer of 250 columns takes 1 ms to read and 1 MB to keep, a column of 12,800 rows 0.15 ms.
_OPEN_FILES = 128
T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class _OpenFile:
    """A file with its footer read; ``columns``: names and types of what it holds."""

    reader: pq.ParquetFile
    columns: dict[str, pa.DataType]


@dataclass(frozen=True, eq=False)
class StoredTable:
    """A committed table in the registered schema; offers what reports use of a ``pyarrow.Table``.

    Raises
    ------
    IntegrityError : by every method, where a file is not what was committed.
    """

    files: tuple[Path, ...]
    rows: tuple[int, ...]
    schema: pa.Schema
    column_names: tuple[str, ...]
    _kept: OrderedDict[str, tuple[pa.ChunkedArray, int]] = field(default_factory=OrderedDict, repr=False)
    _open: dict[Path, _OpenFile] = field(default_factory=dict, repr=False)

    @property
    def num_rows(self) -> int:
        """Number of rows."""
        return sum(self.rows)

    def __getitem__(self, name: str) -> pa.ChunkedArray:
        """A column, whole: numbers in one piece, texts as :func:`joined` makes them."""
        if name not in self._kept:
            parts = (chunk for k in range(len(self.files)) for chunk in self._column(k, name).chunks)
            column = joined(parts, self.schema.field(name).type, self.num_rows)
            self._kept[name] = column, column.nbytes
        self._kept.move_to_end(name)
        found, _ = self._kept[name]
        while len(self._kept) > 1 and sum(size for _, size in self._kept.values()) > _KEPT_BYTES:
            self._kept.popitem(last=False)
        return found

    def slice(self, offset: int, length: int) -> pa.Table:
        """Rows from ``offset`` on."""
        parts, first = [self._empty()], 0
        for k, rows in enumerate(self.rows):
            low, high = max(offset - first, 0), min(offset + length - first, rows)
            if low < high:
                columns = [self._column(k, name).slice(low, high - low) for name in self.column_names]
                parts.append(pa.Table.from_arrays(columns, schema=self._schema()))
            first += rows
        return pa.concat_tables(parts)

    def rows_equal(self, name: str, word: str) -> pa.Table:
        """The rows whose text in the column ``name`` is ``word``; parts that cannot hold it are not read."""
        parts = [self._empty()]
        for k, path in enumerate(self.files):
            if _may_hold(self._opened(path).reader.metadata, name, word):
                columns = [self._column(k, column) for column in self.column_names]
                parts.append(rows_equal(pa.Table.from_arrays(columns, schema=self._schema()), name, word))
        return pa.concat_tables(parts)

    def select(self, names: Sequence[str]) -> StoredTable:
        """The table with these columns alone."""
        return replace(self, column_names=tuple(names))

    def to_batches(self) -> Iterator[pa.RecordBatch]:
        """The rows in parts, in order; few are in memory at a time."""
        for k in range(len(self.files)):
            columns = [self._column(k, name) for name in self.column_names]
            yield from pa.Table.from_arrays(columns, schema=self._schema()).to_batches()

    def _schema(self) -> pa.Schema:
        return pa.schema([self.schema.field(name) for name in self.column_names])

    def _empty(self) -> pa.Table:
        columns = [pa.nulls(0, self.schema.field(name).type) for name in self.column_names]
        return pa.Table.from_arrays(columns, schema=self._schema())

    def _column(self, k: int, name: str) -> pa.ChunkedArray:
        """A column of file ``k``; null where it was registered after the file was written."""
        kind = self.schema.field(name).type
        opened = self._opened(self.files[k])
        if name not in opened.columns:
            return pa.chunked_array([pa.nulls(self.rows[k], kind)])
        found = _read(lambda: opened.reader.read(columns=[name], use_threads=False).column(0))
        if opened.columns[name] != kind or len(found) != self.rows[k]:
            raise IntegrityError(
                f"{self.files[k]} is not what was committed",
                value=f"{name}: {len(found)} of {opened.columns[name]}",
                allowed=f"{self.rows[k]} of {kind}",
                next_step="run `gyroscreen verify`",
            )
        return found

    def _opened(self, path: Path) -> _OpenFile:
        if path in self._open:
            return self._open[path]
        # Without reading ahead: for one column at a time it only hands the read to another thread, half of the time of a column.
        reader = _read(lambda: pq.ParquetFile(path, page_checksum_verification=True, pre_buffer=False))
        opened = _OpenFile(reader, {column.name: column.type for column in reader.schema_arrow})
        if len(self._open) < _OPEN_FILES:
            self._open[path] = opened
        return opened


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
        check_file(folder, entry)
    schema = schema_of(kind)
    files = tuple(folder / entry.name for entry in entries)
    return StoredTable(files, tuple(entry.rows or 0 for entry in entries), schema, tuple(schema.names))


def _may_hold(footer: pq.FileMetaData, name: str, word: str) -> bool:
    """Whether the statistics of a file leave room for ``word`` in the column ``name``."""
    places = [k for k in range(footer.num_columns) if footer.schema.column(k).name == name]
    for group in range(footer.num_row_groups):
        for found in (footer.row_group(group).column(k).statistics for k in places):
            if found is None or not found.has_min_max or found.min <= word <= found.max:
                return True
    return False


def _read(read: Callable[[], T]) -> T:
    try:
        return read()
    except (pa.ArrowException, OSError) as error:
        raise IntegrityError(
            f"results cannot be read ({str(error).splitlines()[0]})", next_step="run `gyroscreen verify`"
        ) from None
