"""Processor time of compare and refine for a lot: ``python tests/measure/lot_time.py [DEVICES] [QUANTITIES] [posterior]``.

Wafers of 50 devices, 8 wafers a lot; the shipped population; reading the table is not counted.
"""

import resource
import sys
import time
from dataclasses import replace

import msgspec
import numpy as np

from pipeline.learning.lot.gyro import COORDINATES, NEEDED, UNITS, coordinates, propagated
from pipeline.learning.lot.measured import MeasuredLot, hold_out
from pipeline.learning.lot.table import LotTable
from populations.draw import draw
from populations.spec import load_spec
from workflows.lots.loop import lot_answers
from workflows.lots.simulate import NOISE, measured_values


def lot_of(devices: int, quantities: int) -> MeasuredLot:
    spec = load_spec(None)
    wafer = msgspec.structs.replace(spec.wafer, lots_per_batch=max(devices // 400, 1), wafers_per_lot=8)
    made = draw(msgspec.structs.replace(spec, wafer=wafer), 2, 0, devices)
    values = measured_values(made, np.random.default_rng(2))
    covariance = propagated(values, {name: np.full(devices, NOISE[name]) for name in NEEDED})
    keep = slice(0, quantities)
    return hold_out(
        MeasuredLot(
            "lot", COORDINATES[keep], UNITS[keep], coordinates(values)[:, keep], covariance[:, keep, keep],
            {"lot": made.lot, "wafer": made.wafer}, made.die_x_mm, made.die_y_mm, 50.0, np.full(devices, np.nan),
            made.device_id,
        )
    )  # fmt: skip


def main() -> None:
    devices = int(sys.argv[1]) if len(sys.argv) > 1 else 2000
    quantities = int(sys.argv[2]) if len(sys.argv) > 2 else 8
    answers = lot_answers(LotTable(lot_of(devices, quantities), True, "package", {}))
    for name in ("comparison", "refinement"):
        start = time.process_time()
        getattr(replace(answers), name)
        print(f"{name}: {time.process_time() - start:.1f} s of processor time")
    if "posterior" in sys.argv[3:]:
        own = replace(answers)
        _ = own.ready
        start = time.process_time()
        found = own.posterior("compare", 3)
        took = time.process_time() - start
        print(f"posterior of 3 spreads: {took:.1f} s, R-hat {found.rhat:.3f}, ESS {found.ess:.0f} of {found.draws}")
        print(f"sd of the error of ln L: {found.surface_error:.2f}")
    print(f"peak {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MB")


if __name__ == "__main__":
    main()
