"""The devices of a run file by file: what must hold of the whole table without the table in memory."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from hashlib import blake2b
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from .digest import TableDigest
from .manifest import Kind, Manifest
from .read import read_block


@dataclass(frozen=True)
class Streamed:
    """Rows and digest of the devices of a run, and the names that have more than one row, sorted."""

    rows: int
    digest: str
    twice: tuple[str, ...]


def streamed(folder: Path, manifest: Manifest) -> Streamed:
    """Read all devices once; twice where a name may occur twice.

    Raises
    ------
    IntegrityError : a file is not what was committed.
    """
    digest, names, rows = TableDigest(), Names(), 0
    for table in tables(folder, manifest, "devices"):
        digest.add(table)
        names.add(table)
        rows += table.num_rows
    return Streamed(rows, digest.result(), names.twice(lambda: tables(folder, manifest, "devices")))


def tables(folder: Path, manifest: Manifest, kind: Kind) -> Iterator[pa.Table]:
    """The verified files of a table in block order, one at a time; raises as :func:`.read.read_block`."""
    return (read_block(folder, entry) for entry in manifest.of_kind(kind))


@dataclass
class Names:
    """Names of devices by hashes of 8 bytes each; those that may occur twice are read again."""

    hashes: list[npt.NDArray[np.uint64]] = field(default_factory=list)

    def add(self, devices: pa.Table) -> None:
        """Add the devices of a table."""
        self.hashes.append(_hashes(devices))

    def twice(self, again: Callable[[], Iterable[pa.Table]]) -> tuple[str, ...]:
        """Names that occur more than once, sorted; ``again`` gives all tables once more."""
        whole = np.sort(np.concatenate([np.zeros(0, np.uint64), *self.hashes]))
        suspects = np.unique(whole[1:][whole[1:] == whole[:-1]])
        if not suspects.size:
            return ()
        found: Counter[str] = Counter()
        for table in again():
            places = np.flatnonzero(np.isin(_hashes(table), suspects))
            found.update(table.column("device_id").take(places).to_pylist())
        return tuple(sorted(name for name, times in found.items() if times > 1))


def _hashes(devices: pa.Table) -> npt.NDArray[np.uint64]:
    names = devices.column("device_id").to_pylist()
    return np.frombuffer(b"".join(blake2b(name.encode(), digest_size=8).digest() for name in names), np.uint64)
