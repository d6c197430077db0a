"""The ``devices`` table as arrays: nulls and absent columns become nan or "".

The table may be on disk (``ColumnSource``): a column is read when it is asked for.

Shapes: B devices.  Units are those of the results columns.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Protocol

import numpy as np
import pyarrow as pa

from pipeline.arrays import BoolArray, FloatArray
from pipeline.store.column import column_array, number_values, rows_equal, text_codes
from pipeline.store.columns import StoredTable

from .coded import CodedText, coded, paired
from .limits import Limit


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

    def select(self, names: Sequence[str]) -> Any:
        """Some columns, with ``to_batches``."""

    def to_batches(self) -> Iterable[pa.RecordBatch]:
        """The rows in parts."""


def wafer_name(lot: str, wafer: str) -> str:
    """Wafer name prefixed with its lot, unless it already begins with the lot: ("L1", "W2") and ("L1", "L1-W2")."""
    rest = wafer.removeprefix(lot)
    named = rest != wafer and not rest[:1].isalnum()
    return wafer if named else f"{lot} {wafer}".strip()


def rows_of(source: ColumnSource, device_id: str) -> pa.Table:
    """The rows of a device."""
    if isinstance(source, StoredTable):  # skips parts that cannot hold them, unread
        return source.rows_equal("device_id", device_id)
    return rows_equal(source.select(source.column_names), "device_id", device_id)


@dataclass(frozen=True, eq=False)
class TruthCheck:
    """The truth of virtual devices against one limit.

    Parameters
    ----------
    conforms : (B,) whether it conforms; nan does not.
    finite : (B,) whether it is known.
    whole : whether none is nan.
    """

    conforms: BoolArray
    finite: BoolArray
    whole: bool


@dataclass(frozen=True, eq=False)
class Devices:
    """The columns present in a ``devices`` table: a measured batch has no truth and may have no wafer."""

    table: ColumnSource
    _checked: dict[tuple[str, Limit], TruthCheck] = field(default_factory=dict, repr=False)

    def __len__(self) -> int:
        return int(self.table.num_rows)

    def number(self, name: str) -> FloatArray:
        """(B,) values of a numeric column, in its unit; nan where null or absent."""
        if name not in self.table.column_names:
            return np.full(len(self), np.nan)
        return number_values(self.table[name])

    def truth(self, limit: Limit, stage: str = "true") -> TruthCheck:
        """The truth against a limit, as packaged (``stage`` "true") or fabricated ("fab"); kept: a column is read once."""
        if (stage, limit) not in self._checked:
            values = self.number(f"{stage}_{limit.quantity}")
            self._checked[stage, limit] = TruthCheck(
                limit.admits(values), np.isfinite(values), not np.isnan(values).any()
            )
        return self._checked[stage, limit]

    def text(self, name: str, rows: Sequence[int] | None = None) -> CodedText:
        """B values of a text column, or those of ``rows``; "" where null or absent."""
        if name not in self.table.column_names:
            return CodedText(("",), np.zeros(len(self) if rows is None else len(rows), dtype=np.int64))
        whole = self.table[name]
        if rows is not None:
            whole = whole.take(column_array(np.asarray(rows, dtype=np.int64), pa.int64(), len(rows), "rows"))
        return CodedText(*text_codes(whole))

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
        return self.text(name).equals(word)

    def wafers(self) -> CodedText:
        """B names of wafers, unique over lots; "" where unknown."""
        pairs, index = paired(self.text("lot"), self.text("wafer"))
        names = coded([wafer_name(lot, wafer) if wafer else "" for lot, wafer in pairs])
        return CodedText(names.words, names.codes[index])
