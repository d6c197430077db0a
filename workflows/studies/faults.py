"""A stub device with faults on demand: it shows that a night ends whatever one device does, without any physics.

A stub takes ``seconds`` and has the row of its number; the faults are by device number.
"""

from __future__ import annotations

import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pipeline.store.schema import devices_table

from ..config import RunConfig
from ..screening.block import BlockTables
from ..screening.guard import Begin
from ..screening.parts import BlockItem
from .fault_kinds import FAULTS


@dataclass(frozen=True)
class Stub:
    """What a worker does with a block of stubs.

    Parameters
    ----------
    seconds : duration of a device [s].
    faults : number of a device -> name of its fault.
    once : folder that remembers faults, where each is to happen only once.
    count : folder where a byte is written for each device computed.
    """

    seconds: float = 0.0
    faults: Mapping[int, str] = field(default_factory=dict)
    once: Path | None = None
    count: Path | None = None

    __name__ = "stub"

    def __call__(self, config: RunConfig, item: BlockItem, begin: Begin) -> BlockTables:
        """The tables of the block."""
        block = item.block
        numbers = range(block.first, block.first + block.count)
        if not block.lost:
            for number in numbers:
                begin(number)
                time.sleep(self.seconds)
                self._fault(number)
                if self.count is not None:
                    with (self.count / str(os.getpid())).open("ab", buffering=0) as file:
                        file.write(b".")
        status = "lost" if block.lost else "ok"
        columns: dict[str, Sequence[Any]] = {
            "device_id": [f"stub-{number:08d}" for number in numbers],
            "theta_deg": [(0.37 * number) % 90.0 for number in numbers],
            "verdict": ["undecided" if block.lost else "pass"] * block.count,
            "status": [status] * block.count,
            "status_reason": [block.lost or None] * block.count,
        }
        return BlockTables(block.index, devices_table(columns), None, {status: block.count})

    def _fault(self, number: int) -> None:
        name = self.faults.get(number)
        if name is None:
            return
        if self.once is not None:
            seen = self.once / f"{name}-{number}"
            if seen.exists():
                return
            seen.touch()
        FAULTS[name]()
