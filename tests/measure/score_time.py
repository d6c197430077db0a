"""Processor time of the scores of effects: devices of the default run with and without them, in turn.

    python tests/measure/score_time.py [DEVICES] [ROUNDS]

Of each device the least time over the rounds counts, which other work on the machine disturbs least.
"""

from __future__ import annotations

import sys
import time

import numpy as np
from threadpoolctl import threadpool_limits

from pipeline.inference.gate import Undetected
from pipeline.inference.screening import device as screening
from populations.draw import draw
from workflows.config import RunConfig
from workflows.screening.settings import population
from workflows.screening.virtual_device import identify_virtual


def measured(devices: int, rounds: int) -> dict[str, float]:
    """Least processor time per device [s], mean over the devices, without and with the scores."""
    config = RunConfig()
    spec = population(config)
    gain, drawn = float(spec.angular_gain), draw(spec, 51, 0, devices)
    nothing = Undetected("", 1.0, {}, {}, {})
    kinds = {"without": lambda *_: nothing, "with": screening.scored_device}
    times = {kind: np.full(devices, np.inf) for kind in kinds}
    for _ in range(rounds + 1):
        for i in range(devices):
            for kind, scored in kinds.items():
                screening.scored_device = scored
                start = time.process_time()
                identify_virtual(config, drawn, i, gain)
                times[kind][i] = min(times[kind][i], time.process_time() - start)
    return {kind: float(each.mean()) for kind, each in times.items()}


if __name__ == "__main__":
    size = [int(one) for one in sys.argv[1:]] + [12, 6][len(sys.argv) - 1 :]
    with threadpool_limits(limits=1):
        found = measured(*size)
    extra = found["with"] - found["without"]
    print(f"without {1e3 * found['without']:.1f} ms, with {1e3 * found['with']:.1f} ms per device")
    print(
        f"the scores take {100 * extra / found['with']:.1f} % of the time, {100 * extra / found['without']:.1f} % more"
    )
