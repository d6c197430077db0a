"""How often the 95 % intervals of the capability indices cover the process, in simulated nights of nested lots.

usage: python -m tests.measure.capability_coverage [NIGHTS]; the default is 1000 nights of each design (half a minute).
The process: lots sd 0.8, wafers 0.5, devices 1.0; Cp = 1, Cpk = 1 and Pp = Ppk = 0.727.
"""

from __future__ import annotations

import math
import sys

import numpy as np

from pipeline.store.schema import devices_table
from reports.capability import capabilities
from reports.devices import Devices
from reports.limits import Limit, Limits
from reports.rules import Rule

DESIGNS = ((3, 4, 25), (5, 2, 20), (6, 3, 12), (20, 5, 10))
LOT, WAFER, DEVICE = 0.8, 0.5, 1.0


def night(random: np.random.Generator, lots: int, wafers: int, dies: int) -> Devices:
    """The devices of one night."""
    lot = np.repeat(np.arange(lots), wafers * dies)
    wafer = np.repeat(np.arange(lots * wafers), dies)
    x = random.normal(0.0, LOT, lots)[lot] + random.normal(0.0, WAFER, lots * wafers)[wafer]
    x = 5.0 + x + random.normal(0.0, DEVICE, lot.size)
    table = {
        "device_id": [str(i) for i in range(x.size)],
        "status": ["ok"] * x.size,
        "split_hz": x,
        "split_hz_sd": 0.0 * x,
    }
    return Devices(devices_table({**table, "lot": [f"L{i}" for i in lot], "wafer": [f"W{i}" for i in wafer]}))


def main() -> None:
    """Print the coverage of each index in each design."""
    nights = int(sys.argv[1]) if len(sys.argv) > 1 else 1000
    overall = 1.0 / math.sqrt(LOT**2 + WAFER**2 + DEVICE**2)
    true = {"cp": 1.0, "cpk": 1.0, "pp": overall, "ppk": overall}
    limits = Limits(Rule(), (Limit("split_hz", 2.0, 8.0),))
    for design in DESIGNS:
        random, covered = np.random.default_rng(8), dict.fromkeys(true, 0)
        for _ in range(nights):
            (found,) = capabilities(night(random, *design), limits)
            for name, at in true.items():
                index = getattr(found, name)
                covered[name] += index.low <= at <= index.high
        shares = ", ".join(f"{name} {count / nights:.3f}" for name, count in covered.items())
        print(f"{design[0]} lots x {design[1]} wafers x {design[2]} dies: {shares}", flush=True)


if __name__ == "__main__":
    main()
