"""HDF5: vectors and tables of few columns, in any group (a MAT file of version 7.3 has this form)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np

from ..stated_rate import stated_rate
from .table import MOST_COLUMNS, Columns, allow, vectors

#: Deepest nesting of groups that is read.
_DEPTH = 4


def _is_signal(member: Any) -> bool:
    """Whether a dataset is a vector, or a table of few columns, of numbers that lie in this file."""
    return (
        isinstance(member, h5py.Dataset)
        and member.dtype.kind in "fiub"
        and member.ndim <= 2
        and (member.size == max(member.shape, default=1) or 1 < min(member.shape) <= MOST_COLUMNS)
        and not member.external
        and not member.is_virtual
    )


def _members(group: Any, prefix: str, depth: int) -> dict[str, Any]:
    """Signals of a group and the groups in it by path; only hard links are followed, because other links can leave the file."""
    found: dict[str, Any] = {}
    for name in group:
        if name.startswith("#") or not isinstance(group.get(name, getlink=True), h5py.HardLink):
            continue
        member = group[name]
        if _is_signal(member):
            found[prefix + name] = member
        elif isinstance(member, h5py.Group) and depth > 1:
            found |= _members(member, f"{prefix}{name}/", depth - 1)
    return found


def _rate(file: Any, members: dict[str, Any]) -> Columns:
    """The sample rate that an attribute of the file, a group of signals or a signal states, as one number by its name."""
    for holder in (file, *(member.parent for member in members.values()), *members.values()):
        numbers = {name: np.ravel(value) for name, value in holder.attrs.items() if np.size(value) == 1}
        if (found := stated_rate(numbers)) is not None:
            return {found[0]: numbers[found[0]]}
    return {}


def read(path: Path) -> Columns:
    """All real vectors, (N,), (1, N) or (N, 1), and the columns of tables, by path; a folder that all share is left out.

    An attribute that states the sample rate is a column of one number.
    """
    with h5py.File(path, "r") as file:
        found = _members(file, "", _DEPTH)
        # Chunks that were never written read as fill values, so the file size does not bound a damaged shape.
        allow(sum(int(member.size) for member in found.values()), path.stat().st_size)
        shared = {name.rpartition("/")[0] for name in found}
        cut = len(next(iter(shared))) + 1 if len(shared) == 1 and shared != {""} else 0
        columns: Columns = {}
        for name, member in found.items():
            columns |= vectors(name[cut:], np.asarray(member[()]))
        columns = {**_rate(file, found), **columns}
    return columns


def write(path: Path, columns: Columns) -> None:
    """One dataset with checksums per column."""
    with h5py.File(path, "w") as file:
        for name, values in columns.items():
            file.create_dataset(name, data=values, fletcher32=True)
