"""Processor time of the functions that a device passes through, each with what it calls: ms per device, calls per device.

    python tests/measure/part_times.py [DEVICES] [ROUNDS]

Of each block of 24 devices the least time over the rounds counts, which other work on the machine disturbs least.
"""

from __future__ import annotations

import importlib
import sys
import time
from collections import defaultdict
from collections.abc import Callable
from typing import Any

from threadpoolctl import threadpool_limits

from workflows.config import RunConfig
from workflows.screening.block import DeviceBlock, virtual_block

TOGETHER = 24
#: The functions, by the module that calls them.
PARTS = {
    "workflows.screening.block": "draw fit_virtual results_of judged_devices tables_of",
    "workflows.screening.virtual_device": "virtual_records virtual_volts measured noise_spectrum fit_device",
    "pipeline.inference.screening.device": "identify_record best_fit model_volts full_band_quality sample",
    "pipeline.inference.screening.fit": "compress",
    "pipeline.inference.screening.compressed": "feature_columns triangle_of",
    "pipeline.inference.screening.sample": "_sufficient_rows _independence_chains _t_draws diagnose",
    "pipeline.inference.screening.batch": "_log_likelihood",
    "pipeline.inference.screening.result": "scored_devices _result",
    "pipeline.inference.screening.undetected.device": (
        "_linear band_motion _along signatures _of_record _products _posed _judged_of"
        " scanned_products white_products judged_scans"
    ),
    "pipeline.inference.screening.undetected.signatures": (
        "forces_of adc_changes sense_changes time_changes readout_signatures"
    ),
    "pipeline.inference.screening.undetected.forces": "force_of_devices first_harmonic",
    "pipeline.inference.screening.undetected.linear": "respond",
    "pipeline.identification.route": "bandpass fit_arx modes_of",
    "pipeline.identification.modes": "refine",
}


def _timed(work: Callable[..., Any], total: list[float]) -> Callable[..., Any]:
    """``work``, which adds its processor time [s] and its calls to ``total``."""

    def timed(*given: Any, **named: Any) -> Any:
        start = time.process_time()
        try:
            return work(*given, **named)
        finally:
            total[0] += time.process_time() - start
            total[1] += 1.0

    return timed


def measured(devices: int, rounds: int) -> list[tuple[float, float, str]]:
    """(ms per device, calls per device, name) of all devices and of each part, the longest first."""
    now: dict[str, list[float]] = {"a device": [0.0, 0.0]}
    for module, names in PARTS.items():
        for name in names.split():
            own, total = importlib.import_module(module), now.setdefault(f"{module}.{name}", [0.0, 0.0])
            setattr(own, name, _timed(getattr(own, name), total))
    config = RunConfig()
    blocks = [DeviceBlock(i, first, TOGETHER) for i, first in enumerate(range(0, devices, TOGETHER))]
    least: dict[tuple[int, str], list[float]] = {}
    for _ in range(rounds + 1):
        for block in blocks:
            for total in now.values():
                total[:] = 0.0, 0.0
            start = time.process_time()
            virtual_block(config, block)
            now["a device"][:] = time.process_time() - start, float(TOGETHER)
            for key, total in now.items():
                least[block.index, key] = min(least.get((block.index, key), total), list(total))
    found: dict[str, list[float]] = defaultdict(lambda: [0.0, 0.0])
    for (_, key), (seconds, calls) in least.items():
        found[key][0] += seconds
        found[key][1] += calls
    count = len(blocks) * TOGETHER
    return sorted(((1e3 * s / count, calls / count, key) for key, (s, calls) in found.items()), reverse=True)


if __name__ == "__main__":
    size = [int(one) for one in sys.argv[1:]] + [48, 6][len(sys.argv) - 1 :]
    with threadpool_limits(limits=1):
        for ms, calls, key in measured(*size):
            print(f"{ms:7.3f} ms {calls:6.2f} calls  {key}")
