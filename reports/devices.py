"""The ``devices`` table as arrays: nulls and absent columns become nan or "".

Shapes: B devices.  Units are those of the results columns.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pyarrow as pa

from pipeline.arrays import BoolArray, FloatArray


def wafer_name(lot: str, wafer: str) -> str:
    """Wafer name prefixed with its lot, unless it already begins with the lot: ("L1", "W2") and ("L1", "L1-W2")."""
    rest = wafer.removeprefix(lot)
    named = rest != wafer and not rest[:1].isalnum()
    return wafer if named else f"{lot} {wafer}".strip()


@dataclass(frozen=True, eq=False)
class Devices:
    """The columns present in a ``devices`` table: a measured batch has no truth and may have no wafer."""

    table: pa.Table

    def __len__(self) -> int:
        return int(self.table.num_rows)

    def number(self, name: str) -> FloatArray:
        """(B,) values of a numeric column, in its unit; nan where null or absent."""
        if name not in self.table.column_names:
            return np.full(len(self), np.nan)
        return np.array(self.table[name].cast(pa.float64()).to_pylist(), dtype=np.float64)

    def text(self, name: str) -> tuple[str, ...]:
        """B values of a text column; "" where null or absent."""
        if name not in self.table.column_names:
            return ("",) * len(self)
        return tuple("" if value is None else str(value) for value in self.table[name].to_pylist())

    def is_ok(self) -> BoolArray:
        """(B,) whether the identification is ok."""
        return np.array([status == "ok" for status in self.text("status")], dtype=np.bool_)

    def identified(self) -> bool:
        """Whether any device could be judged; without one there is no yield."""
        return bool((self.is_ok() | self.has("pass") | self.has("fail")).any())

    def has(self, verdict: str) -> BoolArray:
        """(B,) whether the verdict is this one."""
        return np.array([one == verdict for one in self.text("verdict")], dtype=np.bool_)

    def wafers(self) -> tuple[str, ...]:
        """B names of wafers, unique over lots; "" where unknown."""
        pairs = zip(self.text("lot"), self.text("wafer"), strict=True)
        return tuple(wafer_name(lot, wafer) if wafer else "" for lot, wafer in pairs)
