"""Digest of a table's values.

    digest = SHA-256( for each column: name, type, validity, values with nulls zeroed )

It depends only on the values, their order and the column names, not on chunks, blocks, metadata, file
layout or the bytes under a null.  Two runs with the same table have the same digest.  Every bit counts:
-0.0 differs from 0.0.
"""

from __future__ import annotations

import hashlib

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from ..errors import UsageError


def table_digest(table: pa.Table) -> str:
    """SHA-256 (hex) of the values of a table whose columns are numbers, booleans or text.

    Raises
    ------
    UsageError : a column of another type.
    """
    sha = hashlib.sha256()
    for field in table.schema:
        column = table.column(field.name).combine_chunks()
        if isinstance(column, pa.ChunkedArray):
            column = pa.concat_arrays(column.chunks) if column.num_chunks else pa.array([], field.type)
        sha.update(f"{field.name}\0{field.type}\0{len(column)}\0".encode())
        sha.update(np.packbits(pc.is_valid(column).to_numpy(zero_copy_only=False)).tobytes())
        sha.update(_values(column, field))
    return sha.hexdigest()


def _values(column: pa.Array, field: pa.Field) -> bytes:
    if pa.types.is_string(field.type) or pa.types.is_large_string(field.type):
        words = [word.encode() for word in pc.fill_null(column, "").to_pylist()]
        lengths = np.array([len(word) for word in words], dtype="<i8")
        return lengths.tobytes() + b"".join(words)
    if pa.types.is_integer(field.type) or pa.types.is_floating(field.type):
        values = pc.fill_null(column, pa.scalar(0, field.type)).to_numpy(zero_copy_only=False)
        return np.ascontiguousarray(values, dtype=values.dtype.newbyteorder("<")).tobytes()
    if pa.types.is_boolean(field.type):
        return np.packbits(pc.fill_null(column, False).to_numpy(zero_copy_only=False)).tobytes()
    raise UsageError(f"no digest for column {field.name}", value=str(field.type), allowed="numbers, booleans or text")
