"""Tables whose files are checked as they are opened: Arrow reads the very bytes whose SHA-256 was computed.

DuckDB asks a dataset for a scanner whenever it reads a view, whatever the text of the statement is; this one checks each file
that it opens.
"""

from __future__ import annotations

import hashlib
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.dataset as ds
from pyarrow.fs import LocalFileSystem

from ..errors import IntegrityError

#: Files that are read and hashed ahead of the one that is scanned.
_AHEAD = 2
_FORMAT = ds.ParquetFileFormat(
    default_fragment_scan_options=ds.ParquetFragmentScanOptions(page_checksum_verification=True)
)
#: What happens to an error of a scan before it is raised: a process that answers one query reports it and ends.
Refuse = Callable[[IntegrityError], None]


def checked(path: str, accepted: Sequence[str]) -> bytes:
    """The bytes of a file.

    Raises
    ------
    IntegrityError : it cannot be read, or its SHA-256 is not ``accepted``.
    """
    next_step = "run `gyroscreen verify` for the whole list; restore the file from a copy, or run again"
    try:
        data = Path(path).read_bytes()
    except OSError as error:
        raise IntegrityError(
            f"{path} was committed and cannot be read ({error.strerror})", next_step=next_step
        ) from None
    found = hashlib.sha256(data).hexdigest()
    if found not in accepted:
        raise IntegrityError(
            f"{path} is not what was committed",
            value=f"{len(data)} bytes, sha256 {found}",
            allowed=f"sha256 {accepted[0]}",
            next_step=next_step,
        )
    return data


class CommittedFiles(ds.InMemoryDataset):  # type: ignore[misc]
    """The files of ``rows`` (run_id, path, sha256) as one table with ``schema``; ``run_id`` follows from the file."""

    def __init__(self, rows: Sequence[Mapping[str, Any]], schema: pa.Schema, refuse: Refuse) -> None:
        super().__init__([], schema)
        self._refuse = refuse
        self._accepted = {row["path"]: row["sha256"] for row in rows}
        self._files = ds.FileSystemDataset.from_paths(
            list(self._accepted),
            schema=schema,
            format=_FORMAT,
            filesystem=LocalFileSystem(),
            partitions=[ds.field("run_id") == row["run_id"] for row in rows],
        )

    def scanner(self, columns: Sequence[str] | None = None, filter: ds.Expression | None = None) -> VerifiedScan:
        """What DuckDB reads: these columns of the rows that pass ``filter``."""
        names = self.schema.names if columns is None else list(columns)
        return VerifiedScan(
            pa.schema([self.schema.field(name) for name in names]), lambda: self._batches(names, filter)
        )

    def _batches(self, columns: list[str], filter: ds.Expression | None) -> Iterator[pa.RecordBatch]:
        fragments = deque(self._files.get_fragments(filter))
        with ThreadPoolExecutor(_AHEAD) as pool:
            waiting: deque[tuple[ds.Fragment, Future[bytes]]] = deque()
            while fragments or waiting:
                while fragments and len(waiting) <= _AHEAD:
                    fragment = fragments.popleft()
                    job = pool.submit(checked, fragment.path, self._accepted[fragment.path])
                    waiting.append((fragment, job))
                fragment, job = waiting.popleft()
                try:
                    data = job.result()
                except IntegrityError as error:
                    self._refuse(error)
                    raise
                source = _FORMAT.make_fragment(
                    pa.BufferReader(data), partition_expression=fragment.partition_expression
                )
                yield from source.to_batches(schema=self.schema, columns=columns, filter=filter)


@dataclass(frozen=True, eq=False)
class VerifiedScan:
    """One pass over a table."""

    projected_schema: pa.Schema
    batches: Callable[[], Iterator[pa.RecordBatch]]

    def to_reader(self) -> pa.RecordBatchReader:
        """The batches, read when they are asked for."""
        return pa.RecordBatchReader.from_batches(self.projected_schema, self.batches())


def views(
    refuse: Refuse,
    files: pa.Table,
    devices: pa.Table,
    posterior: pa.Table,
    irregularities: pa.Table,
    runs: pa.Table,
    columns: pa.Table,
) -> dict[str, Any]:
    """The views by name: runs and columns as given, the others from ``files`` with the schemas of the tables."""
    rows = files.to_pylist()
    found: dict[str, Any] = {"runs": runs, "columns": columns}
    for name, empty in (("devices", devices), ("posterior", posterior), ("irregularities", irregularities)):
        found[name] = CommittedFiles([row for row in rows if row["view"] == name], empty.schema, refuse)
    return found
