"""How often the intervals of a reweighted loss hold, by the effective number of lots with loss.

    python tests/measure/reweighting_coverage.py [--repeats 150]

Loss of a sum of normals of lot, wafer and die (40 devices a lot) with the share 0.18 or 0.034; one spread gets another size.
"""

from __future__ import annotations

import argparse
import itertools

import numpy as np

from reports.attribution.reweighting import log_weights, reweighted_share
from tests.reports.attribution.test_reweighting import SPREADS, drawn, loss

_EDGES = (0, 3, 5, 8, 12, 20, 50, np.inf)


def main() -> None:
    """Print the coverage of the share after the change and of the difference, for smaller and for wider spreads."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=150)
    repeats = parser.parse_args().repeats
    random = np.random.default_rng(5)
    for name, factors in (("smaller", (0.5, 0.8)), ("wider", (1.2,))):
        rows = []
        for limit in (0.8, 1.6):
            for level in SPREADS:
                for factor in factors:
                    before, after = loss(limit), loss(limit, **{level: factor})
                    for lots in (5, 15, 40, 120, 360):
                        for _ in range(repeats):
                            lot, z, lost = drawn(random, lots, limit)
                            one = reweighted_share(lost, lot, log_weights(z[level][:, None], factor))
                            of_share = one.after.low <= after <= one.after.high
                            change = one.difference
                            rows.append((one.lots_with_loss, of_share, change.low <= after - before <= change.high))
        found = np.array(rows, dtype=float)
        for low, high in itertools.pairwise(_EDGES):
            own = found[(found[:, 0] >= low) & (found[:, 0] < high)]
            if len(own):
                share, difference = own[:, 1:].mean(axis=0)
                text = f"share {share:.3f}, difference {difference:.3f}, of {len(own)}"
                print(f"{name} spread, {low} to {high} effective lots with loss: {text}")


if __name__ == "__main__":
    main()
