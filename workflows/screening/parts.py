"""Blocks of devices as items of work: divided where a device ends its worker, and put together again before the commit.

Workers load this module, so it imports nothing that identification does not need.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import pyarrow as pa

from ..config import RunConfig
from .block import BlockTables, DeviceBlock, virtual_block
from .campaign_block import campaign_block
from .campaign_source import CampaignSource
from .faults import Faults
from .guard import Begin


@dataclass(frozen=True)
class BlockItem:
    """A block, or a part of one, with the campaigns of its devices if these are measured."""

    block: DeviceBlock
    campaigns: tuple[CampaignSource, ...] = ()


def block_items(blocks: Sequence[DeviceBlock], campaigns: tuple[CampaignSource, ...]) -> list[BlockItem]:
    """The items of a run; ``campaigns`` are those of all devices, or empty."""
    return [BlockItem(block, campaigns[block.first : block.first + block.count]) for block in blocks]


def block_task(config: RunConfig, item: BlockItem, begin: Begin) -> BlockTables:
    """One block of virtual or measured devices; runs in a worker."""
    if config.source.kind == "population":
        return virtual_block(config, item.block, begin)
    return campaign_block(config, item.block, item.campaigns, begin)


def _part(item: BlockItem, span: range) -> BlockItem:
    block = replace(item.block, first=span.start, count=len(span))
    offset = span.start - item.block.first
    return BlockItem(block, item.campaigns[offset : offset + len(span)])


BLOCK_FAULTS: Faults[BlockItem] = Faults(
    devices=lambda item: range(item.block.first, item.block.first + item.block.count),
    part=_part,
    lost=lambda item, reason: replace(item, block=replace(item.block, lost=reason)),
)


@dataclass
class Assembly:
    """Parts of blocks that wait for the others."""

    blocks: Mapping[int, DeviceBlock]
    parts: dict[int, dict[int, BlockTables]] = field(default_factory=dict)

    def add(self, part: DeviceBlock, tables: BlockTables) -> BlockTables | None:
        """The tables of the whole block, in the order of its devices, once all of its parts are there."""
        own = self.parts.setdefault(part.index, {})
        own[part.first] = tables
        if sum(one.devices.num_rows for one in own.values()) < self.blocks[part.index].count:
            return None
        del self.parts[part.index]
        return joined([own[first] for first in sorted(own)])


def joined(parts: Sequence[BlockTables]) -> BlockTables:
    """The tables of a block from those of its parts."""
    if len(parts) == 1:
        return parts[0]
    posterior = [part.posterior for part in parts if part.posterior is not None]
    irregularities = [part.irregularities for part in parts if part.irregularities is not None]
    statuses: dict[str, int] = {}
    for part in parts:
        for status, count in part.statuses.items():
            statuses[status] = statuses.get(status, 0) + count
    return BlockTables(
        parts[0].index,
        pa.concat_tables([part.devices for part in parts]).combine_chunks(),
        pa.concat_tables(posterior).combine_chunks() if posterior else None,
        statuses,
        pa.concat_tables(irregularities).combine_chunks() if irregularities else None,
    )
