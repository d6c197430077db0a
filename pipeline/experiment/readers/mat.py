"""MATLAB files: v5 by scipy, v7.3 as the HDF5 file that it is.

A v5 file is a row of elements, each a tag (type, bytes) and its data; type 15 is a deflated element.  The
tags are walked before scipy reads the file, because it asks for the memory that a tag claims.
"""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import loadmat, savemat
from scipy.io.matlab import MatReadError

from ...errors import MeasurementError
from . import hdf5
from .table import MAX_VALUES, Columns, allow, vector

_HEADER = 128
_COMPRESSED, _MATRIX = 15, 14
_HDF5_MAGIC = b"\x89HDF\r\n\x1a\n"
#: No number of a MAT file has more bytes than this; names and dimensions come on top.
_MAX_BYTES = 8 * MAX_VALUES + 2**20


def _damaged(where: str) -> MeasurementError:
    return MeasurementError(
        "a MAT element claims more bytes than the file holds",
        value=where,
        allowed="elements that lie inside the file",
        next_step="the file is damaged: copy it again from its source",
    )


def _walk(data: bytes, order: str, depth: int) -> None:
    """Check that the elements in ``data`` and inside its matrices lie inside it."""
    at = 0
    while at + 8 <= len(data):
        kind, count = struct.unpack_from(order + "II", data, at)
        if kind >> 16:  # small element: bytes in the upper half, data in the tag itself
            if kind >> 16 > 4:
                raise _damaged(f"small element at {at}")
            at += 8
            continue
        if count > len(data) - at - 8:
            raise _damaged(f"element at {at}")
        body = data[at + 8 : at + 8 + count]
        if kind == _COMPRESSED:
            if depth:
                raise _damaged(f"deflated element inside another at {at}")
            stream = zlib.decompressobj()
            inflated = stream.decompress(body, _MAX_BYTES)
            if stream.unconsumed_tail:
                allow(MAX_VALUES + 1, len(data))
            if not stream.eof:
                raise _damaged(f"deflated element at {at}")
            _walk(inflated, order, depth + 1)
            at += 8 + count
            continue
        if kind == _MATRIX:
            if depth > 8:
                raise _damaged(f"matrices nested too deeply at {at}")
            _walk(body, order, depth + 1)
        at += 8 + count + (-count) % 8


def _fields(value: Any) -> dict[str, Any]:
    """Fields of a 1 x 1 struct, else nothing."""
    if isinstance(value, np.ndarray) and value.dtype.names and value.size == 1:
        return {name: value[name].flat[0] for name in value.dtype.names}
    return {}


def read(path: Path) -> Columns:
    """All real vectors, as variables or inside the one struct that the file holds."""
    with path.open("rb") as file:
        start = file.read(1024)
    # MATLAB puts 512 bytes of its own in front of the HDF5 file; other writers put none.
    if start[:8] == _HDF5_MAGIC or start[512:520] == _HDF5_MAGIC:
        return hdf5.read(path)
    data = path.read_bytes() if path.stat().st_size <= _MAX_BYTES else b""
    if not data:
        allow(path.stat().st_size // 8 or MAX_VALUES + 1, path.stat().st_size)
    marker = data[126:128]
    if marker not in (b"IM", b"MI") or data[:4] == b"\0\0\0\0":
        raise MatReadError("not a MAT file of version 5 or 7.3")
    _walk(data[_HEADER:], "<" if marker == b"IM" else ">", 0)
    variables = {name: value for name, value in loadmat(path).items() if not name.startswith("__")}
    structs = [fields for fields in map(_fields, variables.values()) if fields]
    inside = structs[0] if len(structs) == 1 else {}
    found = {name: vector(v) for name, v in {**inside, **variables}.items() if isinstance(v, np.ndarray)}
    return {name: values for name, values in found.items() if values is not None}


def write(path: Path, columns: Columns) -> None:
    """Version 5, column vectors, deflated (which carries a checksum)."""
    savemat(path, dict(columns), do_compression=True, oned_as="column")
