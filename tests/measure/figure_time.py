"""Share of the processor time of a device that its quantities and intervals take, with nothing and with everything declared.

    python tests/measure/figure_time.py [devices] [rounds]

The devices are those of the default run, identified in this process; the columns are medians over rounds, in turn.
"""

from __future__ import annotations

import sys
import time

import msgspec
import numpy as np

from pipeline.experiment.files.common_tables import OperationTable
from pipeline.inference import estimate, systematic
from pipeline.inference.screening import result as identification
from workflows.config import load_config
from workflows.config_tables import RunTable
from workflows.screening.block import DeviceBlock, virtual_block

DECLARED = OperationTable(
    drive_amplitude_v=1.0,
    softening_hz_per_v2=-0.03,
    gap_um=10.0,
    mass_mg=50.0,
    damping_ppm_per_c=1300.0,
    shock_ms=0.5,
)


def main(devices: int, rounds: int) -> None:
    spent = 0.0

    def timed(call):  # type: ignore[no-untyped-def]
        def inner(*args):  # type: ignore[no-untyped-def]
            nonlocal spent
            start = time.process_time()
            out = call(*args)
            spent += time.process_time() - start
            return out

        return inner

    systematic.quantities = timed(estimate.quantities)
    estimate.intervals = timed(estimate.intervals)
    identification.with_measured_noise = timed(identification.with_measured_noise)
    base = msgspec.structs.replace(load_config(None), run=RunTable(devices=devices, block=devices))
    kinds = {"nothing declared": OperationTable(), "all declared": DECLARED}
    virtual_block(base, DeviceBlock(0, 0, 1))
    rows: dict[str, list[tuple[float, float]]] = {name: [] for name in kinds}
    for _ in range(rounds):
        for name, table in kinds.items():
            spent, start = 0.0, time.process_time()
            virtual_block(msgspec.structs.replace(base, operation=table), DeviceBlock(0, 0, devices))
            rows[name].append((1e3 * spent / devices, 1e3 * (time.process_time() - start) / devices))
    for name, found in rows.items():
        own, whole = np.median(found, axis=0)
        print(
            f"{name:18s} quantities and intervals {own:5.2f} ms of {whole:5.1f} ms a device, {100 * own / whole:.1f} %"
        )


if __name__ == "__main__":
    main(*(int(word) for word in (sys.argv[1:] + ["6", "5"][len(sys.argv) - 1 :])))
