"""Parquet.  Pages carry checksums when written and are verified when read."""

from __future__ import annotations

from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from .table import Columns, allow


def read(path: Path) -> Columns:
    """All numeric columns."""
    with pq.ParquetFile(path, page_checksum_verification=True, memory_map=False) as file:
        numeric = [
            field.name
            for field in file.schema_arrow
            if pa.types.is_floating(field.type) or pa.types.is_integer(field.type) or pa.types.is_boolean(field.type)
        ]
        # Run-length encoding has no bound of its own on expansion, so only the number of values is limited.
        allow(file.metadata.num_rows * max(len(numeric), 1), 2**62)
        table = file.read(columns=numeric, use_threads=False)
    table.validate(full=True)
    return {name: table.column(name).to_numpy() for name in numeric}


def write(path: Path, columns: Columns) -> None:
    """One row group column a vector."""
    pq.write_table(pa.table(dict(columns)), path, write_page_checksum=True, use_dictionary=False)
