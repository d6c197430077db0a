"""Values as an Arrow column and back; NaN and ``None`` become null (see ``schema``).

Arrays are made from their buffers and taken from them, because ``pa.array``, ``to_numpy`` and scalars load pandas, which takes
0.4 s and 50 MB in every worker.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from ..arrays import FloatArray
from ..errors import UsageError

#: A column of texts is kept as numbers of words unless more of the rows than this have a word of their own.
_MOST_WORDS = 0.25
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


def joined(parts: Iterable[pa.Array], kind: pa.DataType, rows: int) -> pa.ChunkedArray:
    """A column of ``rows`` values from its parts, each of which is released once it is copied.

    Numbers lie in one piece; texts are a dictionary and the numbers of its words, unless nearly every row has a word of its own.
    """
    if pa.types.is_string(kind):
        return _joined_texts(parts, rows)
    if not (pa.types.is_floating(kind) or pa.types.is_integer(kind)):
        return pa.chunked_array(list(parts), kind)
    values = np.empty(rows, kind.to_pandas_dtype())
    known: npt.NDArray[np.bool_] | None = None
    first = 0
    for part in parts:
        values[first : first + len(part)] = raw_values(part)
        if part.null_count:
            known = np.ones(rows, dtype=np.bool_) if known is None else known
            known[first : first + len(part)] = validity(part)
        first += len(part)
    return pa.chunked_array([pa.Array.from_buffers(kind, rows, [_bitmap(known), pa.py_buffer(values)])])


def _joined_texts(parts: Iterable[pa.Array], rows: int) -> pa.ChunkedArray:
    codes = np.empty(rows, dtype=np.int32)
    place: dict[str | None, int] = {}
    whole: list[pa.Array] = []
    first = 0
    for part in parts:
        encoded = part.dictionary_encode("encode")
        if whole or len(encoded.dictionary) > _MOST_WORDS * len(part):
            whole.append(part)
            continue
        own = [place.setdefault(word, len(place)) for word in encoded.dictionary.to_pylist()]
        codes[first : first + len(part)] = np.array([*own, 0], dtype=np.int32)[raw_values(encoded.indices)]
        first += len(part)
    words = _text_array(list(place))
    known = pa.DictionaryArray.from_arrays(
        pa.Array.from_buffers(pa.int32(), first, [None, pa.py_buffer(codes[:first])]), words
    )
    return pa.chunked_array([known.cast(pa.string()), *whole] if whole else [known])


def number_values(column: pa.ChunkedArray) -> FloatArray:
    """(n,) values of a numeric column, read-only; NaN where null."""
    if column.num_chunks == 1 and pa.types.is_float64(column.type) and not column.null_count:
        return _read_only(raw_values(column.chunk(0)))
    out = np.full(len(column), np.nan)
    first = 0
    for chunk in column.cast(pa.float64()).chunks:
        if chunk.null_count < len(chunk):
            out[first : first + len(chunk)] = np.where(validity(chunk), raw_values(chunk), np.nan)
        first += len(chunk)
    return _read_only(out)


def validity(chunk: pa.Array) -> npt.NDArray[np.bool_]:
    """(n,) whether a value is not null."""
    if chunk.null_count in (0, len(chunk)):
        return np.full(len(chunk), chunk.null_count == 0)
    return _bits(chunk.buffers()[0], chunk)


def raw_values(chunk: pa.Array) -> np.ndarray[Any, Any]:
    """(n,) values of an array of numbers or booleans, 0 where null."""
    if chunk.null_count == len(chunk):
        return np.zeros(len(chunk), dtype=chunk.type.to_pandas_dtype())
    data = chunk.buffers()[1]
    if pa.types.is_boolean(chunk.type):
        return _bits(data, chunk) & validity(chunk)
    values = np.frombuffer(data, chunk.type.to_pandas_dtype())[chunk.offset : chunk.offset + len(chunk)]
    return np.where(validity(chunk), values, values.dtype.type(0)) if chunk.null_count else values


def text_codes(column: pa.ChunkedArray) -> tuple[tuple[str, ...], npt.NDArray[np.int64]]:
    """The different words of a text column, "" for null, and the number (n,) of the word of each row."""
    if pa.types.is_dictionary(column.type) and column.num_chunks == 1:
        encoded = column.chunk(0)
    else:
        encoded = column.cast(pa.string()).combine_chunks().dictionary_encode("encode")
    words = ["" if word is None else word for word in encoded.dictionary.to_pylist()]
    indices = encoded.indices
    codes = raw_values(indices).astype(np.int64)
    if words.count("") > 1:  # null and "" are one word
        place = {word: k for k, word in enumerate(words)}
        codes = np.array([place[word] for word in words])[codes]
    return tuple(words), codes


def rows_equal(table: pa.Table, name: str, word: str) -> pa.Table:
    """The rows of a table whose text in the column ``name`` is ``word``."""
    words, codes = text_codes(table[name])
    wanted = np.array([one == word for one in (*words, None)])[codes]
    return table.filter(pa.Array.from_buffers(pa.bool_(), codes.size, [None, _packed(wanted)]))


def _bits(bitmap: pa.Buffer, chunk: pa.Array) -> npt.NDArray[np.bool_]:
    bits = np.unpackbits(np.frombuffer(bitmap, np.uint8), bitorder="little")
    return bits[chunk.offset : chunk.offset + len(chunk)].astype(np.bool_)


def _packed(bits: npt.NDArray[np.bool_]) -> pa.Buffer:
    return pa.py_buffer(np.packbits(bits, bitorder="little"))


def _text_array(values: Values) -> pa.Array:
    # A name stands in many rows, and is encoded once.  A list holds the same objects whenever it is read: no nan equals another.
    listed = list(values)
    place = {value: k for k, value in enumerate(dict.fromkeys(listed))}
    codes = [place[value] for value in listed]
    known = np.array([value is not None and value == value for value in place], dtype=np.bool_)
    words = [str.encode(value, "utf-8") if here else b"" for value, here in zip(place, known)]
    ends = np.zeros(len(codes) + 1, dtype=np.int32)
    np.cumsum(np.array([len(word) for word in words], dtype=np.int32)[codes], out=ends[1:])
    data = b"".join([words[code] for code in codes])
    return pa.Array.from_buffers(
        pa.string(), len(codes), [_bitmap(known[codes]), pa.py_buffer(ends), pa.py_buffer(data)]
    )


def _number_array(values: Values, kind: pa.DataType) -> pa.Array:
    raw = np.asarray(values if isinstance(values, np.ndarray) else [np.nan if v is None else v for v in values])
    if raw.ndim != 1 or (raw.size and raw.dtype.kind not in "fiub"):
        raise TypeError(f"{raw.dtype} of shape {raw.shape}")
    known = ~np.isnan(raw.astype(np.float64))
    if known.all() and raw.dtype == kind.to_pandas_dtype():
        return pa.Array.from_buffers(kind, raw.size, [None, pa.py_buffer(raw.copy())])
    with np.errstate(invalid="ignore"):
        numbers = np.where(known, raw, 0).astype(kind.to_pandas_dtype())
    if np.any(numbers != np.where(known, raw, 0)):
        raise ValueError("a value that the type cannot hold")
    return pa.Array.from_buffers(kind, raw.size, [_bitmap(known), pa.py_buffer(numbers)])


def _bitmap(known: npt.NDArray[np.bool_] | None) -> pa.Buffer | None:
    return None if known is None or known.all() else _packed(known)


def _read_only(values: FloatArray) -> FloatArray:
    """The array, which may be the very memory of a column."""
    values.flags.writeable = False
    return values
