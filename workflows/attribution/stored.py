"""The stored irregularities of a run beside the rows of its devices.

Shapes: N devices, d numbers.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pipeline.arrays import FloatArray, IntArray
from pipeline.errors import IntegrityError
from pipeline.store.stored_numbers import Key, read_numbers
from reports.devices import Devices


@dataclass(frozen=True, eq=False)
class StoredRunNumbers:
    """Numbers (N, d) [1] of the first devices of a run.

    Parameters
    ----------
    keys : (d,) irregularity, level, label, component.
    rows : (N,) rows of these devices in the devices table; ``index`` their numbers.
    lot : (N,) lot; die_x_mm, die_y_mm : (N,) place on the wafer [mm].
    """

    keys: tuple[Key, ...]
    values: FloatArray
    rows: IntArray
    index: IntArray
    lot: IntArray
    die_x_mm: FloatArray
    die_y_mm: FloatArray


def stored_numbers(folder: Path, devices: Devices, most: int) -> StoredRunNumbers | None:
    """The numbers of about the first ``most`` devices of the run in ``folder``; ``None`` where it stored none.

    Raises
    ------
    IntegrityError : the table does not belong to these devices.
    """
    found = read_numbers(folder, most)
    if not found.device_id:
        return None
    rows = _rows(devices, found.device_id)
    return StoredRunNumbers(
        found.keys,
        found.values.astype(np.float64),
        rows,
        # The id of a virtual device is D and its number (populations.draw).
        np.array([int(name[1:]) for name in found.device_id], dtype=np.int64),
        devices.text("lot").codes[rows],
        devices.number("die_x_mm")[rows],
        devices.number("die_y_mm")[rows],
    )


def _rows(devices: Devices, names: tuple[str, ...]) -> IntArray:
    """Rows of the named devices: both tables are in the order of the blocks, so that these are the first ones."""
    first = np.arange(min(len(names), len(devices)), dtype=np.int64)
    if tuple(devices.text("device_id", first.tolist())) == names:
        return first
    ids = devices.text("device_id")  # blocks without irregularities lie between
    row = {ids.words[code]: k for k, code in enumerate(ids.codes.tolist())}
    if any(name not in row for name in names):
        raise IntegrityError(
            "table irregularities holds devices that table devices lacks", next_step="run `gyroscreen verify`"
        )
    return np.array([row[name] for name in names], dtype=np.int64)
