"""Processor time of the scores of effects: devices of the default run with and without them, in turn.

    python tests/measure/score_time.py [DEVICES] [ROUNDS]

Of each block of eight devices the least time over the rounds counts, which other work on the machine disturbs least.
"""

from __future__ import annotations

import sys
import time

import numpy as np
from threadpoolctl import threadpool_limits

from pipeline.inference.gate import Undetected
from pipeline.inference.screening import result
from workflows.config import RunConfig
from workflows.screening import block
from workflows.screening.block import DeviceBlock, virtual_block


def measured(devices: int, rounds: int) -> dict[str, float]:
    """Least processor time per device [s], mean over the blocks, without and with the scores."""
    config = RunConfig()
    nothing = Undetected("", 1.0, {}, {}, {})
    kinds = {"without": lambda scorings: [nothing] * len(scorings), "with": result.scored_devices}
    together = block._TOGETHER
    blocks = [DeviceBlock(i, first, together) for i, first in enumerate(range(0, devices, together))]
    times = {kind: np.full(len(blocks), np.inf) for kind in kinds}
    for _ in range(rounds + 1):
        for own in blocks:
            for kind, scored in kinds.items():
                result.scored_devices = scored
                start = time.process_time()
                virtual_block(config, own)
                times[kind][own.index] = min(times[kind][own.index], time.process_time() - start)
    return {kind: float(each.mean()) / together for kind, each in times.items()}


if __name__ == "__main__":
    size = [int(one) for one in sys.argv[1:]] + [16, 6][len(sys.argv) - 1 :]
    with threadpool_limits(limits=1):
        found = measured(*size)
    extra = found["with"] - found["without"]
    print(f"without {1e3 * found['without']:.1f} ms, with {1e3 * found['with']:.1f} ms per device")
    print(
        f"the scores take {100 * extra / found['with']:.1f} % of the time, {100 * extra / found['without']:.1f} % more"
    )
