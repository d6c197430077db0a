"""Stub devices with the rows of real ones: name and site as drawn, values of 25 identified devices, each varied at random.

Every number of a row is multiplied by 1 + 1e-3 e with a normal e, so that rows cost as many bytes as real ones and no encoding
profits from their repetition.  Probabilities, counts and words are those of the device that a row is taken from.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import pyarrow as pa

from pipeline.experiment.files.common_tables import SystematicTable
from populations.layout import places

from ...config import RunConfig
from ...screening.block import BlockTables, DeviceBlock, virtual_block
from ...screening.guard import Begin
from ...screening.parts import BlockItem
from ...screening.settings import population

_REAL = 25
_SPREAD, _STREAM = 1e-3, 112
#: Columns that are kept, because the report relies on their range.
_KEPT = ("p_pass", "p_value", "effect_p_value", "rhat", "acceptance")


@lru_cache(maxsize=1)
def _real(systematic: SystematicTable) -> BlockTables:
    """The tables of ``_REAL`` devices of the default run with these common errors, which a worker identifies once."""
    return virtual_block(RunConfig(systematic=systematic), DeviceBlock(0, 0, _REAL))


def _varied(table: pa.Table, random: np.random.Generator) -> pa.Table:
    columns = []
    for field, column in zip(table.schema, table.columns):
        if pa.types.is_floating(field.type) and not field.name.startswith(_KEPT) and column.null_count < len(column):
            values = column.to_numpy()
            values = values * (1.0 + _SPREAD * random.standard_normal(values.size))
            columns.append(pa.array(values, field.type, from_pandas=True))
        else:
            columns.append(column)
    return pa.table(columns, schema=table.schema)


def _replaced(table: pa.Table, values: dict[str, object]) -> pa.Table:
    for name, value in values.items():
        at = table.schema.get_field_index(name)
        table = table.set_column(at, table.schema.field(at), pa.array(value, table.schema.field(at).type))
    return table


@dataclass(frozen=True)
class StubRows:
    """What a worker does with a block of stub devices."""

    __name__ = "stub rows"

    def __call__(self, config: RunConfig, item: BlockItem, begin: Begin) -> BlockTables:
        """The tables of the block."""
        block, real = item.block, _real(config.systematic)
        random = np.random.default_rng(np.random.SeedSequence(config.run.seed, spawn_key=(_STREAM, block.index)))
        index = np.arange(block.first, block.first + block.count)
        placed = places(population(config).wafer, index)
        lots = [f"L{lot + 1:02d}" for lot in placed.lot.tolist()]
        names = [f"D{n:06d}" for n in index.tolist()]
        begin(block.first)
        of = index % _REAL
        site = {
            "device_id": names,
            "lot": lots,
            "wafer": [f"{lot}-W{wafer + 1:02d}" for lot, wafer in zip(lots, placed.wafer_in_lot.tolist())],
            "die_x_mm": placed.x_mm,
            "die_y_mm": placed.y_mm,
            "package": [f"P{n:06d}" for n in index.tolist()],
        }
        devices = _replaced(_varied(real.devices.take(pa.array(of)), random), site)
        draws = config.posterior.stored_draws
        posterior = None
        if draws and real.posterior is not None:
            rows = (of[:, None] * draws + np.arange(draws)).ravel()
            each = np.repeat(np.array(names, dtype=object), draws)
            posterior = _replaced(_varied(real.posterior.take(pa.array(rows)), random), {"device_id": each})
        return BlockTables(block.index, devices, posterior, {"ok": block.count})
