"""The devices table of a run with some columns replaced: what reports read, as if the run had been judged by the new limits."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa

from pipeline.store.column import column_array

from ..coded import CodedText
from ..devices import ColumnSource


@dataclass(frozen=True, eq=False)
class Replaced:
    """``table`` with the columns ``own`` instead of its own; a source of columns for reports."""

    table: ColumnSource
    own: dict[str, pa.ChunkedArray]

    @property
    def num_rows(self) -> int:
        """Number of rows."""
        return self.table.num_rows

    @property
    def column_names(self) -> Sequence[str]:
        """Names of the columns."""
        return self.table.column_names

    def __getitem__(self, name: str) -> pa.ChunkedArray:
        """A column."""
        return self.own[name] if name in self.own else self.table[name]

    def slice(self, offset: int, length: int) -> pa.Table:
        """Some rows, all columns."""
        part = self.table.slice(offset, length)
        for name, column in self.own.items():
            place = part.schema.get_field_index(name)
            part = part.set_column(place, part.schema.field(place), column.slice(offset, length))
        return part

    def select(self, names: Sequence[str]) -> Any:
        """Some columns."""
        return pa.table({name: self[name] for name in names})

    def to_batches(self) -> Iterable[pa.RecordBatch]:
        """The rows in parts."""
        return list(self.select(self.column_names).to_batches())


def replaced(table: ColumnSource, texts: dict[str, CodedText], numbers: dict[str, np.ndarray[Any, Any]]) -> Replaced:
    """``table`` with text and number columns replaced; "" and nan become null."""
    own: dict[str, pa.ChunkedArray] = {}
    for name, text in texts.items():
        words = pa.array([word or None for word in text.words], pa.string())
        own[name] = pa.chunked_array([words.take(pa.array(text.codes, pa.int64()))])
    for name, values in numbers.items():
        own[name] = pa.chunked_array([column_array(values, pa.float64(), len(values), name)])
    return Replaced(table, own)
