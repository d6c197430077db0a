"""The ``devices`` table as arrays: nulls and absent columns become nan or "".

The table may be on disk (``ColumnSource``): a column is read when it is asked for.

Shapes: B devices.  Units are those of the results columns.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from pipeline.arrays import BoolArray, FloatArray

from .coded import CodedText, coded, paired


class ColumnSource(Protocol):
    """What reports use of a table: a ``pyarrow.Table``, or a stored table that is read column by column."""

    @property
    def num_rows(self) -> int:
        """Number of rows."""

    @property
    def column_names(self) -> Sequence[str]:
        """Names of the columns."""

    def __getitem__(self, name: str) -> pa.ChunkedArray:
        """A column."""

    def slice(self, offset: int, length: int) -> pa.Table:
        """Some rows, all columns."""

    def filter(self, wanted: pc.Expression) -> pa.Table:
        """The rows that fulfil an expression."""

    def select(self, names: Sequence[str]) -> Any:
        """Some columns, with ``to_batches``."""

    def to_batches(self) -> Iterable[pa.RecordBatch]:
        """The rows in parts."""


def wafer_name(lot: str, wafer: str) -> str:
    """Wafer name prefixed with its lot, unless it already begins with the lot: ("L1", "W2") and ("L1", "L1-W2")."""
    rest = wafer.removeprefix(lot)
    named = rest != wafer and not rest[:1].isalnum()
    return wafer if named else f"{lot} {wafer}".strip()


@dataclass(frozen=True, eq=False)
class Devices:
    """The columns present in a ``devices`` table: a measured batch has no truth and may have no wafer."""

    table: ColumnSource

    def __len__(self) -> int:
        return int(self.table.num_rows)

    def number(self, name: str) -> FloatArray:
        """(B,) values of a numeric column, in its unit; nan where null or absent."""
        if name not in self.table.column_names:
            return np.full(len(self), np.nan)
        return np.array(self.table[name].cast(pa.float64()).to_numpy())

    def text(self, name: str, rows: Sequence[int] | None = None) -> CodedText:
        """B values of a text column, or those of ``rows``; "" where null or absent."""
        if name not in self.table.column_names:
            return CodedText(("",), np.zeros(len(self) if rows is None else len(rows), dtype=np.int64))
        whole = self.table[name] if rows is None else self.table[name].take(pa.array(rows, pa.int64()))
        column = pc.fill_null(whole.cast(pa.string()), "").combine_chunks().dictionary_encode()
        return CodedText(tuple(column.dictionary.to_pylist()), column.indices.to_numpy().astype(np.int64))

    def is_ok(self) -> BoolArray:
        """(B,) whether the identification is ok; read-only."""
        return self._ok

    @cached_property
    def _ok(self) -> BoolArray:
        found = self._equals("status", "ok")
        found.flags.writeable = False  # every caller gets the same array
        return found

    def identified(self) -> bool:
        """Whether any device could be judged; without one there is no yield."""
        return bool((self.is_ok() | self.has("pass") | self.has("fail")).any())

    def has(self, verdict: str) -> BoolArray:
        """(B,) whether the verdict is this one."""
        return self._equals("verdict", verdict)

    def _equals(self, name: str, word: str) -> BoolArray:
        if name not in self.table.column_names:
            return np.zeros(len(self), dtype=np.bool_)
        return np.array(pc.fill_null(pc.equal(self.table[name].cast(pa.string()), word), False).to_numpy(), np.bool_)

    def wafers(self) -> CodedText:
        """B names of wafers, unique over lots; "" where unknown."""
        pairs, index = paired(self.text("lot"), self.text("wafer"))
        names = coded([wafer_name(lot, wafer) if wafer else "" for lot, wafer in pairs])
        return CodedText(names.words, names.codes[index])
