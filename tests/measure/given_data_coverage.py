"""Coverage of the 95 % intervals of shares from stored devices, by number of lots.

    python tests/measure/given_data_coverage.py [--repeats 200]

The sum 0.5 lot + 0.3 wafer + 0.7 die + 0.4 die, with 40 devices a lot.
"""

from __future__ import annotations

import argparse

import numpy as np

from reports.attribution.given_data import given_data_shares
from tests.reports.attribution.test_shares import EACH, SIZES, lots_of, outputs


def main() -> None:
    """Print coverage and sd of the share of lot, wafer, die and die."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=200)
    repeats = parser.parse_args().repeats
    truth, random = SIZES**2 / np.sum(SIZES**2), np.random.default_rng(3)
    for lots in (20, 60, 200):
        held, values = [], []
        for _ in range(repeats):
            lot, z = lots_of(random, lots)
            found = given_data_shares(z, EACH, lot, outputs(z)[:, :1])
            values.append(found.value[:4, 0])
            held.append((truth >= found.low[:4, 0]) & (truth <= found.high[:4, 0]))
        print(f"{lots} lots: coverage {np.mean(held, axis=0).round(3)}, sd {np.std(values, axis=0).round(3)}")


if __name__ == "__main__":
    main()
