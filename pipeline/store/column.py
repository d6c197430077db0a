"""Values as an Arrow column and back; NaN and ``None`` become null (see ``schema``).

Arrays are made from their buffers and taken from them, because ``pa.array``, ``to_numpy`` and scalars load pandas, which takes
0.4 s and 50 MB in every worker.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from ..arrays import FloatArray
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


def number_values(column: pa.ChunkedArray) -> FloatArray:
    """(n,) values of a numeric column; NaN where null."""
    out = np.full(len(column), np.nan)
    first = 0
    for chunk in column.cast(pa.float64()).chunks:
        valid, data = chunk.buffers()
        rows = slice(chunk.offset, chunk.offset + len(chunk))
        if chunk.null_count < len(chunk):
            here = np.frombuffer(data, np.float64)[rows]
            known = _bits(valid, rows) if chunk.null_count else True
            out[first : first + len(chunk)] = np.where(known, here, np.nan)
        first += len(chunk)
    return out


def text_codes(column: pa.ChunkedArray) -> tuple[tuple[str, ...], npt.NDArray[np.int64]]:
    """The different words of a text column, "" for null, and the number (n,) of the word of each row."""
    encoded = column.cast(pa.string()).combine_chunks().dictionary_encode("encode")
    words = ["" if word is None else word for word in encoded.dictionary.to_pylist()]
    indices = encoded.indices
    codes = np.frombuffer(indices.buffers()[1], np.int32)[indices.offset :][: len(indices)] if len(indices) else []
    if "" in words and words.count("") > 1:  # null and "" are one word
        place = {word: k for k, word in enumerate(words)}
        return tuple(words), np.array([place[word] for word in words])[np.asarray(codes, dtype=np.int64)]
    return tuple(words), np.asarray(codes, dtype=np.int64)


def rows_equal(table: pa.Table, name: str, word: str) -> pa.Table:
    """The rows of a table whose text in the column ``name`` is ``word``."""
    words, codes = text_codes(table[name])
    wanted = np.array([one == word for one in (*words, None)])[codes]
    return table.filter(pa.Array.from_buffers(pa.bool_(), codes.size, [None, _packed(wanted)]))


def _bits(bitmap: pa.Buffer, rows: slice) -> npt.NDArray[np.bool_]:
    return np.unpackbits(np.frombuffer(bitmap, np.uint8), bitorder="little")[rows].astype(np.bool_)


def _packed(bits: npt.NDArray[np.bool_]) -> pa.Buffer:
    return pa.py_buffer(np.packbits(bits, bitorder="little"))


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
    return None if known.all() else _packed(known)
