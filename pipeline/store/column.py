"""Values as an Arrow column; NaN and ``None`` become null (see ``schema``).

The arrays are made from their buffers, because ``pa.array`` loads pandas, which takes 0.4 s and 50 MB in every worker.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pyarrow as pa

from ..errors import UsageError

Values = Sequence[Any] | np.ndarray[Any, Any]


def column_array(values: Values | None, kind: pa.DataType, rows: int, name: str) -> pa.Array:
    """Column ``name`` with ``rows`` values of the type ``kind``; ``None`` is null throughout.

    Raises
    ------
    UsageError : another number of values, or a value of the wrong type.
    """
    if values is None:
        return pa.nulls(rows, kind)
    if len(values) != rows:
        raise UsageError(f"column {name} has the wrong length", value=len(values), allowed=f"{rows} values")
    try:
        return _text_array(values) if pa.types.is_string(kind) else _number_array(values, kind)
    except (TypeError, ValueError, OverflowError) as error:
        raise UsageError(f"column {name} holds values of the wrong type ({error})", allowed=str(kind)) from None


def _text_array(values: Values) -> pa.Array:
    known = np.array([value is not None and value == value for value in values], dtype=np.bool_)
    words = [str.encode(value, "utf-8") if here else b"" for value, here in zip(values, known)]
    ends = np.cumsum([0, *(len(word) for word in words)]).astype(np.int32)
    buffers = [_bitmap(known), pa.py_buffer(ends), pa.py_buffer(b"".join(words))]
    return pa.Array.from_buffers(pa.string(), len(words), buffers)


def _number_array(values: Values, kind: pa.DataType) -> pa.Array:
    raw = np.asarray(values if isinstance(values, np.ndarray) else [np.nan if v is None else v for v in values])
    if raw.ndim != 1 or (raw.size and raw.dtype.kind not in "fiub"):
        raise TypeError(f"{raw.dtype} of shape {raw.shape}")
    known = ~np.isnan(raw.astype(np.float64))
    with np.errstate(invalid="ignore"):
        numbers = np.where(known, raw, 0).astype(kind.to_pandas_dtype())
    if np.any(numbers != np.where(known, raw, 0)):
        raise ValueError("a value that the type cannot hold")
    return pa.Array.from_buffers(kind, raw.size, [_bitmap(known), pa.py_buffer(numbers)])


def _bitmap(known: np.ndarray[Any, Any]) -> pa.Buffer | None:
    return None if known.all() else pa.py_buffer(np.packbits(known, bitorder="little"))
