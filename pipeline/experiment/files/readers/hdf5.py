"""HDF5: vectors at the root, or in the only group of the file (a MAT file of version 7.3 has this form)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py

from .table import Columns, allow, vector


def _datasets(group: Any) -> dict[str, Any]:
    """Vectors of a group; only hard links are followed, because other links can leave the file."""
    hard = [name for name in group if isinstance(group.get(name, getlink=True), h5py.HardLink)]
    members = {name: group[name] for name in hard if not name.startswith("#")}
    return {
        name: member
        for name, member in members.items()
        if isinstance(member, h5py.Dataset)
        and member.dtype.kind in "fiub"
        and member.ndim > 0
        and member.size == max(member.shape)
        and not member.external
        and not member.is_virtual
    }


def read(path: Path) -> Columns:
    """All real vectors, (N,), (1, N) or (N, 1)."""
    with h5py.File(path, "r") as file:
        groups = [
            file[name] for name in file if not name.startswith("#") and file.get(name, getclass=True) is h5py.Group
        ]
        found = _datasets(file) or (_datasets(groups[0]) if len(groups) == 1 else {})
        # Chunks that were never written read as fill values, so the file size does not bound a damaged shape.
        allow(sum(int(member.size) for member in found.values()), path.stat().st_size)
        values = {name: vector(member[()]) for name, member in found.items()}
    return {name: column for name, column in values.items() if column is not None}


def write(path: Path, columns: Columns) -> None:
    """One dataset with checksums per column."""
    with h5py.File(path, "w") as file:
        for name, values in columns.items():
            file.create_dataset(name, data=values, fletcher32=True)
