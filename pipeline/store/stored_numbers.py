"""The table ``irregularities`` of a run as a matrix: one row a device, one column a number."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from ..errors import IntegrityError
from .column import raw_values, text_codes
from .irregularity_table import irregularities_schema
from .manifest import Manifest
from .read import read_block, settled

Key = tuple[str, str, str, int]


@dataclass(frozen=True, eq=False)
class NumberMatrix:
    """Numbers (N, d) [1] of N devices, float32; ``keys`` (d,) are irregularity, level, label, component."""

    device_id: tuple[str, ...]
    keys: tuple[Key, ...]
    values: npt.NDArray[np.float32]


def read_numbers(folder: Path, most: int) -> NumberMatrix:
    """The numbers of the first devices of a run, of about ``most`` (whole files); none where the run stored none.

    Raises
    ------
    IntegrityError : a file is not what was committed, or its devices have different numbers.
    """
    return settled(folder, lambda manifest: _read(folder, manifest, most))


def _read(folder: Path, manifest: Manifest, most: int) -> NumberMatrix:
    parts: list[NumberMatrix] = []
    for entry in manifest.of_kind("irregularities"):
        if sum(len(part.device_id) for part in parts) >= most:
            break
        parts.append(_matrix(read_block(folder, entry), str(folder / entry.name)))
    if not parts:
        return NumberMatrix((), (), np.zeros((0, 0), dtype=np.float32))
    if any(part.keys != parts[0].keys for part in parts):
        raise _differ(str(folder))
    ids = tuple(name for part in parts for name in part.device_id)
    return NumberMatrix(ids, parts[0].keys, np.concatenate([part.values for part in parts]))


def _matrix(table: pa.Table, where: str) -> NumberMatrix:
    ids, device = text_codes(table["device_id"])
    _, first = np.unique(device, return_index=True)
    d = int(np.sum(device == device[0])) if device.size else 0
    if d == 0 or device.size != d * len(ids) or np.any(device != np.repeat(device[np.sort(first)], d)):
        raise _differ(where)
    names = [text_codes(table[column]) for column in ("irregularity", "level", "label")]
    component = raw_values(table["component"].combine_chunks()).reshape(-1, d)
    codes = [code.reshape(-1, d) for _, code in names]
    if any(np.any(one != one[0]) for one in (*codes, component)):
        raise _differ(where)
    words = [[word[k] for k in code[0].tolist()] for (word, _), code in zip(names, codes, strict=True)]
    keys = tuple(zip(*words, component[0].tolist(), strict=True))
    values = raw_values(table["value"].combine_chunks()).reshape(-1, d)
    order = [ids[k] for k in device[::d].tolist()]
    return NumberMatrix(tuple(order), keys, values)


def _differ(where: str) -> IntegrityError:
    return IntegrityError(
        f"{where}: the devices of table irregularities do not have the same numbers",
        allowed=f"columns {', '.join(irregularities_schema().names)}, the same numbers for each device",
        next_step="an irregularity must read the same numbers for all devices (docs/how-to/add-an-irregularity.md)",
    )
