"""Parquet; page checksums are written and verified."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from ....errors import MeasurementError
from .table import Columns, allow

#: Rows that are decoded at once.
_BATCH = 2**18


def read(path: Path) -> Columns:
    """All numeric columns (N,), one after the other and in parts: a file that expands holds nothing but its values."""
    with pq.ParquetFile(path, page_checksum_verification=True, memory_map=False) as file:
        numeric = [
            field.name
            for field in file.schema_arrow
            if pa.types.is_floating(field.type) or pa.types.is_integer(field.type) or pa.types.is_boolean(field.type)
        ]
        # Run-length encoding can expand without bound, so only the number of values is limited.
        allow(file.metadata.num_rows * max(len(numeric), 1), 2**62)
        if len(set(numeric)) != len(numeric):
            raise MeasurementError(
                "a column name occurs twice",
                value=numeric,
                allowed="a different name for each column",
                next_step="rename or remove one of them",
            )
        return {name: _column(file, name) for name in numeric}


def _column(file: pq.ParquetFile, name: str) -> NDArray[Any]:
    out, at = np.empty(0), 0
    for batch in file.iter_batches(_BATCH, columns=[name], use_threads=False):
        batch.validate(full=True)
        part = _values(batch.column(0))
        if at == 0:
            out = np.empty(file.metadata.num_rows, dtype=part.dtype)
        elif part.dtype != out.dtype:  # whole numbers with gaps become floating-point numbers
            out = out.astype(np.result_type(out, part))
        out[at : at + part.size] = part
        at += part.size
    return out[:at]


def _values(column: pa.Array) -> NDArray[Any]:
    if column.null_count or pa.types.is_boolean(column.type):
        return np.asarray(column.to_numpy(zero_copy_only=False))
    # Gives the same values without importing pandas, which takes a quarter of a second.
    return np.from_dlpack(column)


def write(path: Path, columns: Columns) -> None:
    """One Parquet column per vector, with page checksums."""
    pq.write_table(pa.table(dict(columns)), path, write_page_checksum=True, use_dictionary=False)
