"""NumPy archives of vectors; pickled objects are rejected, because loading them can run code."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
from numpy.lib import format as npy

from ....errors import MeasurementError
from .table import Columns, allow, vector


def _check_sizes(path: Path) -> None:
    """Check that the header of each member states exactly the number of bytes that follow it."""
    size = path.stat().st_size
    total = 0
    with zipfile.ZipFile(path) as archive:
        for member in archive.infolist():
            allow(member.file_size // 8, size)
            with archive.open(member) as file:
                version = npy.read_magic(file)
                read_header = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
                shape, _, dtype = read_header(file)
                count = int(np.prod([int(n) for n in shape], dtype=object))
                if count * dtype.itemsize + file.tell() != member.file_size:
                    raise MeasurementError(
                        "a vector is longer or shorter than its header states",
                        value=member.filename,
                        allowed=f"{count * dtype.itemsize} bytes",
                        next_step="the file is damaged: copy it again from its source",
                    )
                total += count
    allow(total, size)


def read(path: Path) -> Columns:
    """All real vectors, (N,), (1, N) or (N, 1)."""
    _check_sizes(path)
    with np.load(path, allow_pickle=False) as archive:
        found = {name: vector(archive[name]) for name in archive.files}
    return {name: values for name, values in found.items() if values is not None}


def write(path: Path, columns: Columns) -> None:
    """One member per column."""
    with path.open("wb") as file:
        np.savez(file, allow_pickle=False, **columns)
