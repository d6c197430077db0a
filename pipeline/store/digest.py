"""Digest of a table's values, computed part by part: the table need not fit into memory.

    digest = "v2-" SHA-256( rows; for each column with a value: name, type, SHA-256(validity), SHA-256(values), SHA-256(words) )

values with nulls zeroed; of text the values are the lengths in bytes and the words follow.  It depends only on the values,
their order and the column names, not on chunks, blocks, metadata, file layout or the bytes under a null; a column
without any value counts as absent.  Two runs with the same table have the same digest.  Every bit counts: -0.0 differs from 0.0.
"""

from __future__ import annotations

import hashlib

import numpy as np
import pyarrow as pa

from ..errors import UsageError
from .column import raw_values, validity

_VERSION = "v2-"


def comparable(digest: str) -> bool:
    """Whether a digest has the definition of this module; versions before stored other ones."""
    return digest.startswith(_VERSION)


def table_digest(table: pa.Table) -> str:
    """Digest of the values of a table; raises as :meth:`TableDigest.add`."""
    digest = TableDigest()
    digest.add(table)
    return digest.result()


class _ColumnHash:
    """The hashes of one column so far."""

    def __init__(self) -> None:
        self.filled = 0
        self.parts = (hashlib.sha256(), hashlib.sha256(), hashlib.sha256())

    def add(self, column: pa.Array, field: pa.Field) -> None:
        self.filled += len(column) - column.null_count
        valid, values, words = self.parts
        valid.update(validity(column).tobytes())
        numbers, text = _values(column, field)
        values.update(numbers)
        words.update(text)


class TableDigest:
    """The digest of the parts of a table, added in their order."""

    def __init__(self) -> None:
        self._rows = 0
        self._columns: dict[tuple[str, str], _ColumnHash] = {}

    def add(self, table: pa.Table) -> None:
        """Add the next rows; all parts have the same columns.

        Raises
        ------
        UsageError : a column that is neither number, nor boolean, nor text.
        """
        self._rows += table.num_rows
        for field in table.schema:
            column = self._columns.setdefault((field.name, str(field.type)), _ColumnHash())
            for chunk in table.column(field.name).chunks:
                column.add(chunk, field)

    def result(self) -> str:
        """The digest of all rows added."""
        sha = hashlib.sha256(f"{self._rows}\0".encode())
        for (name, kind), column in self._columns.items():
            if column.filled:
                sha.update(f"{name}\0{kind}\0".encode() + b"".join(part.digest() for part in column.parts))
        return _VERSION + sha.hexdigest()


def _values(column: pa.Array, field: pa.Field) -> tuple[bytes, bytes]:
    if pa.types.is_string(field.type) or pa.types.is_large_string(field.type):
        words = [(word or "").encode() for word in column.to_pylist()]
        return np.array([len(word) for word in words], dtype="<i8").tobytes(), b"".join(words)
    if pa.types.is_integer(field.type) or pa.types.is_floating(field.type):
        values = raw_values(column)
        return np.ascontiguousarray(values, dtype=values.dtype.newbyteorder("<")).tobytes(), b""
    if pa.types.is_boolean(field.type):
        return raw_values(column).tobytes(), b""
    raise UsageError(f"no digest for column {field.name}", value=str(field.type), allowed="numbers, booleans or text")
