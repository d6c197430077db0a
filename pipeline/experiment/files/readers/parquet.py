"""Parquet; page checksums are written and verified."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from .table import Columns, allow


def read(path: Path) -> Columns:
    """All numeric columns (N,)."""
    with pq.ParquetFile(path, page_checksum_verification=True, memory_map=False) as file:
        numeric = [
            field.name
            for field in file.schema_arrow
            if pa.types.is_floating(field.type) or pa.types.is_integer(field.type) or pa.types.is_boolean(field.type)
        ]
        # Run-length encoding can expand without bound, so only the number of values is limited.
        allow(file.metadata.num_rows * max(len(numeric), 1), 2**62)
        table = file.read(columns=numeric, use_threads=False)
    table.validate(full=True)
    return {name: _values(table.column(name)) for name in numeric}


def _values(column: pa.ChunkedArray) -> NDArray[Any]:
    if column.null_count or pa.types.is_boolean(column.type):
        return np.asarray(column.to_numpy())
    # Gives the same values without importing pandas, which takes a quarter of a second.
    return np.array(np.from_dlpack(column.combine_chunks()))


def write(path: Path, columns: Columns) -> None:
    """One Parquet column per vector, with page checksums."""
    pq.write_table(pa.table(dict(columns)), path, write_page_checksum=True, use_dictionary=False)
