"""What a campaign needs: an upper bound before anything is read, and one before it is identified.

    bytes = MEMORY_BASE + MEMORY_PER_BYTE * 8 * (values of all records) + MEMORY_COLUMNS * 16 * (bins of the fit records)

The values follow from the metadata of the files; the bins in the band of the identification are known once they are read.
"""

from __future__ import annotations

import zipfile
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from ...errors import MeasurementError
from ...input_limits import MEMORY_BASE, MEMORY_COLUMNS, MEMORY_PER_BYTE, WORKER_BYTES
from ..record import Campaign

_HEAD = 65_536


def stated_values(path: Path) -> int:
    """Number of values that a record file states, or whose number its size suggests; 0 where only its reader can tell."""
    suffix = path.suffix.lower()
    # Whatever is wrong with the file, its reader says so.
    with suppress(Exception):
        if not path.is_file():
            return 0
        if suffix == ".parquet":
            from pyarrow.parquet import read_metadata

            found = read_metadata(path)
            return int(found.num_rows * found.num_columns)
        if suffix == ".npz":
            with zipfile.ZipFile(path) as archive:
                return sum(member.file_size for member in archive.infolist()) // 8
        if suffix in (".h5", ".hdf5"):
            import h5py

            sizes: list[int] = []
            with h5py.File(path, "r") as file:
                file.visititems(lambda _, member: sizes.append(int(getattr(member, "size", 0) or 0)))
            return sum(sizes)
        if suffix in (".mat", ".tdms"):
            return path.stat().st_size // 4  # deflated numbers of 16 bits
        with path.open("rb") as text:
            head = text.read(_HEAD)
        separators = sum(head.count(mark) for mark in (b",", b";", b"\t", b"\n"))
        return separators * path.stat().st_size // max(len(head), 1)
    return 0


def check_memory(files: Iterable[Path], allowed_bytes: int = WORKER_BYTES) -> None:
    """Check that a campaign with these record ``files`` can be read in the memory of a worker.

    Raises
    ------
    MeasurementError : the bound exceeds ``allowed_bytes``.
    """
    _check(sum(stated_values(path) for path in files), 0, allowed_bytes)


def check_identification(campaign: Campaign, low_hz: float, high_hz: float, allowed_bytes: int = WORKER_BYTES) -> None:
    """Check that a campaign can be identified between ``low_hz`` and ``high_hz`` [Hz] in the memory of a worker.

    Raises
    ------
    MeasurementError : the bound exceeds ``allowed_bytes``.
    """
    channels = [record.drive_v.shape[1] + record.sense_v.shape[1] + 1 for record in campaign.records]
    values = sum(count * record.drive_v.shape[0] for count, record in zip(channels, campaign.records))
    _check(values, sum(int((high_hz - low_hz) * one.duration_s) for one in campaign.with_role("fit")), allowed_bytes)


def _check(values: int, bins: int, allowed_bytes: int) -> None:
    needed = MEMORY_BASE + MEMORY_PER_BYTE * 8 * values + MEMORY_COLUMNS * 16 * bins
    if needed > allowed_bytes:
        raise MeasurementError(
            "the records of this campaign need more memory than a worker has",
            value=f"{values} values{f', {bins} frequencies in the band' if bins else ''}, up to {needed / 2**30:.1f} GiB",
            allowed=f"{allowed_bytes / 2**30:.3g} GiB",
            next_step="split or shorten the records; gyroscreen identify has no such limit",
        )
