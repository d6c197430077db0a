"""MATLAB files: version 5 is parsed here, version 7.3 is read as HDF5.

A version 5 file is a sequence of elements, each a tag (type, number of bytes) and its data.  Type 15 is a deflated element.
Type 14 is a matrix: flags, dimensions and name, followed by the data of an array, or by the field names and matrices of a
struct.

Source: MathWorks, MAT-File Format.  scipy.io.loadmat is not used for reading, because it trusts types and sizes: one wrong
byte can crash the interpreter (1 of about 1000 mutated files, scipy 1.17).  scipy is used for writing.
"""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.io import savemat

from ....errors import MeasurementError
from ....input_limits import RECORD_VALUES
from . import hdf5
from .table import MOST_COLUMNS, Columns, allow, vectors

_HEADER = 128
_COMPRESSED, _MATRIX = 15, 14
_STRUCT = 2
#: Deepest nesting of structs that is read.
_DEPTH = 4
#: Array classes of real numbers in full (not sparse) storage.
_NUMBERS = range(6, 16)
_COMPLEX_FLAG = 0x0800
_DTYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_HDF5_MAGIC = b"\x89HDF\r\n\x1a\n"
#: Largest size of a file or of an inflated element [bytes]: the values, plus room for names and dimensions.
_MAX_BYTES = 8 * RECORD_VALUES + 2**20

#: A matrix, a struct of values, or ``None`` for what is no signal.
Value = NDArray[Any] | dict[str, "Value"] | None


def _damaged(where: str) -> MeasurementError:
    return MeasurementError(
        "the file is not a valid MAT file of version 5",
        value=where,
        allowed="elements of known types that lie inside the file",
        next_step="the file is damaged: copy it again from its source",
    )


def _elements(data: bytes, order: str) -> list[tuple[int, bytes]]:
    """Type and data of the elements in ``data``, checked to lie inside it; ``order`` is "<" or ">"."""
    found, at = [], 0
    while at + 8 <= len(data):
        kind, count = struct.unpack_from(order + "II", data, at)
        if kind >> 16:  # small element: number of bytes in the upper half, data in the tag
            kind, count, at, room = kind & 0xFFFF, kind >> 16, at + 4, 4
            following = at + 4
        else:
            at, room = at + 8, len(data) - at - 8
            # Deflated elements are not padded to eight bytes.
            following = at + count + (0 if kind == _COMPRESSED else -count % 8)
        if count > room:
            raise _damaged(f"element of type {kind} with {count} bytes")
        found.append((kind, data[at : at + count]))
        at = following
    if at < len(data):
        raise _damaged(f"{len(data) - at} bytes after the last element")
    return found


def _inflated(body: bytes) -> bytes:
    stream = zlib.decompressobj()
    data = stream.decompress(body, _MAX_BYTES)
    if stream.unconsumed_tail:
        allow(RECORD_VALUES + 1, len(body))
    if not stream.eof:
        raise _damaged("incomplete deflated element")
    return data


def _fields(rest: list[tuple[int, bytes]], order: str, depth: int) -> dict[str, Value]:
    """Values of a 1 x 1 struct; ``rest`` holds the length of a name, the names, and one matrix per field."""
    if len(rest) < 2 or len(rest[0][1]) != 4:
        raise _damaged("struct without field names")
    length, names = struct.unpack(order + "i", rest[0][1])[0], rest[1][1]
    if length < 1 or len(names) != length * (len(rest) - 2):
        raise _damaged("struct with different numbers of names and fields")
    fields: dict[str, Value] = {}
    for k, (kind, body) in enumerate(rest[2:]):
        value = _matrix(body, order, depth - 1)[1] if kind == _MATRIX else None
        if value is not None:
            fields[names[k * length : (k + 1) * length].split(b"\0")[0].decode("ascii")] = value
    return fields


def _matrix(body: bytes, order: str, depth: int = _DEPTH) -> tuple[str, Value]:
    """Name and value of a matrix; ``None`` unless it holds real numbers in few columns, or is a struct of such matrices."""
    parts = _elements(body, order)
    if [kind for kind, _ in parts[:3]] != [6, 5, 1] or len(parts[0][1]) != 8 or len(parts[1][1]) % 4:
        raise _damaged("matrix without flags, dimensions and name")
    flags = struct.unpack_from(order + "I", parts[0][1])[0]
    shape = tuple(int(n) for n in np.frombuffer(parts[1][1], dtype=order + "i4"))
    name, rest, array_class = parts[2][1].decode("ascii"), parts[3:], flags & 0xFF
    if array_class == _STRUCT and shape == (1, 1):
        return name, _fields(rest, order, depth) if depth > 0 else None
    if array_class not in _NUMBERS or flags & _COMPLEX_FLAG:
        return name, None
    if len(rest) != 1 or rest[0][0] not in _DTYPES:
        raise _damaged(f"{name} holds no numbers")
    numbers = np.frombuffer(rest[0][1], dtype=order + _DTYPES[rest[0][0]])
    values = numbers.reshape(shape, order="F")
    return name, values if values.ndim == 2 and min(shape) <= MOST_COLUMNS else None


def _variables(data: bytes, order: str) -> dict[str, Value]:
    found = {}
    for kind, body in _elements(data, order):
        inner = _elements(_inflated(body), order) if kind == _COMPRESSED else [(kind, body)]
        for inner_kind, matrix in inner:
            if inner_kind != _MATRIX:
                raise _damaged(f"variable of type {inner_kind}")
            name, value = _matrix(matrix, order)
            found[name] = value
    return found


def read(path: Path) -> Columns:
    """All real vectors (N,) and columns of matrices, as variables or in structs; a struct that all share is not named.

    Raises
    ------
    MeasurementError : the file is damaged, of an unknown version, or states more values than it can hold.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        start = file.read(1024)
    # MATLAB writes 512 bytes of its own before the HDF5 data; other programs write none.
    if start[:8] == _HDF5_MAGIC or start[512:520] == _HDF5_MAGIC:
        return hdf5.read(path)
    if size > _MAX_BYTES:
        allow(RECORD_VALUES + 1, size)
    orders = {b"IM": "<", b"MI": ">"}
    if start[126:128] not in orders or start[:4] == b"\0\0\0\0":
        raise _damaged("header of an unknown version")
    found = _flat("", _variables(path.read_bytes()[_HEADER:], orders[start[126:128]]))
    shared = {name.rpartition(".")[0] for name, values in found.items() if values.size > 1}
    cut = f"{next(iter(shared))}." if len(shared) == 1 and shared != {""} else ""
    columns: Columns = {}
    for name, values in found.items():
        columns |= vectors(name.removeprefix(cut), values)
    return columns


def _flat(prefix: str, values: dict[str, Value]) -> dict[str, NDArray[Any]]:
    """The matrices of structs by path, ``struct.field``."""
    flat: dict[str, NDArray[Any]] = {}
    for name, value in values.items():
        if isinstance(value, dict):
            flat |= _flat(f"{prefix}{name}.", value)
        elif value is not None:
            flat[prefix + name] = value
    return flat


def write(path: Path, columns: Columns) -> None:
    """Version 5, column vectors, deflated (which includes a checksum)."""
    savemat(path, dict(columns), do_compression=True, oned_as="column")
