"""Devices as the population draws them, without physics: as a block, and as a task of a worker process."""

from __future__ import annotations

from typing import Any

from pipeline.store.schema import devices_table
from populations.draw import draw
from workflows.config import RunConfig
from workflows.screening.block import BlockTables, DeviceBlock
from workflows.screening.drawn_table import drawn_table
from workflows.screening.guard import Begin
from workflows.screening.parts import BlockItem
from workflows.screening.settings import population

#: A file with an irregularity of the user, which scales with ``factor``.
IRREGULARITY = """
from populations.irregularity import Change, Irregularity, IrregularityParameter

def act(p, site):
    return Change(anisotropy={factor} * 0.01 * p["die_pct"] * site.complex_normal("die"))

IRREGULARITY = Irregularity(
    name="own", stage="fabrication", source="a test", act=act,
    parameters=(IrregularityParameter("die_pct", "%", 0.0, 20.0, "leaf mass, relative"),),
)
"""


def drawn_block(source: Any, at: DeviceBlock) -> BlockTables:
    """The frequencies of the devices; each passes."""
    drawn = draw(population(source[0]), source[0].run.seed, at.first, at.count)
    columns = {"status": ["ok"] * at.count, "verdict": ["pass"] * at.count, "true_f1_hz": drawn.true["f1_hz"]}
    devices = devices_table({"device_id": list(drawn.device_id), **columns})
    return BlockTables(at.index, devices, None, {"ok": at.count}, drawn_table(drawn))


def drawn_task(config: RunConfig, item: BlockItem, begin: Begin) -> BlockTables:
    """The same as a task of a worker."""
    for device in range(item.block.first, item.block.first + item.block.count):
        begin(device)
    return drawn_block((config, item.campaigns), item.block)
