"""A block: the tables of some devices, committed together."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc

from ..errors import IntegrityError
from .irregularity_table import schema_of
from .manifest import FileEntry, Kind
from .schema import devices_schema, devices_table, duplicates, require_schema

#: Tables beside the devices, and what their rows are.
_FURTHER: dict[Kind, str] = {"posterior": "draws", "irregularities": "irregularities"}


def block_file(kind: Kind, block: int, last: int | None = None) -> str:
    """File name of a block's table, or of that of the blocks up to ``last``."""
    return f"{kind}-{block:05d}{'' if last is None else f'-{last:05d}'}.parquet"


def other_name(entry: FileEntry) -> str:
    """File name for the amended version of a committed devices table; the old file stays until the manifest changes."""
    plain = block_file("devices", entry.block or 0, entry.last)
    return plain if entry.name != plain else plain.replace(".parquet", "-amended.parquet")


def amended(table: pa.Table, values: Mapping[str, Mapping[str, Any]]) -> pa.Table:
    """Copy of a devices table with the cells device_id -> column -> value replaced, each in the unit of its column.

    The same table if nothing changes.

    Raises
    ------
    UsageError : a column that is not registered, or a value of the wrong type.
    """
    ids = table.column("device_id").to_pylist()
    mine = {name: values[name] for name in ids if name in values}
    columns = {name: table.column(name).to_pylist() for name in table.column_names}
    for column in {column for own in mine.values() for column in own}:
        before = columns.get(column, [None] * len(ids))
        columns[column] = [mine.get(name, {}).get(column, old) for name, old in zip(ids, before)]
    changed = devices_table(columns)
    return table if changed.equals(table) else changed


def check_block(block: int, tables: Mapping[Kind, pa.Table]) -> None:
    """Check the tables of a block before they are committed.

    Raises
    ------
    IntegrityError : a table is not in the registered schema, a device has several rows, or rows of other devices.
    """
    where = f"block {block}"
    require_schema(tables["devices"], devices_schema(), f"{where} of devices")
    require_unique(tables["devices"], where)
    known = tables["devices"].column("device_id")
    for kind, what in _FURTHER.items():
        if kind not in tables:
            continue
        require_schema(tables[kind], schema_of(kind), f"{where} of {kind}")
        foreign = pc.invert(pc.is_in(tables[kind].column("device_id"), value_set=known.combine_chunks()))
        if pc.any(foreign).as_py():
            names = tables[kind].column("device_id").filter(foreign).unique().to_pylist()
            raise IntegrityError(
                f"{where} of {kind} holds {what} of devices that are not in the block", value=names[:5]
            )


def require_unique(devices: pa.Table, where: str) -> None:
    """Raise IntegrityError if a device has more than one row."""
    twice = duplicates(devices)
    if twice:
        raise IntegrityError(f"{where} lists a device more than once", value=twice[:5], allowed="one row a device")
