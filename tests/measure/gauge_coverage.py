"""Coverage of the 95 % intervals of gauge R&R in six designs.

python tests/measure/gauge_coverage.py [--studies 300]
"""

from __future__ import annotations

import argparse

import numpy as np

from reports.gauge import gauge_study
from tests.reports.test_gauge import simulated

#: Parts, testers, sessions of each, repeats; sds of part, tester, session, part x tester, repeatability; share of rows kept.
DESIGNS = {
    "10 x 3 x 3": ((10, 3, 1, 3), (1.0, 0.2, 0.0, 0.0, 0.2), 1.0),
    "with part x tester": ((10, 3, 1, 3), (1.0, 0.2, 0.0, 0.15, 0.2), 1.0),
    "with sessions": ((8, 3, 3, 2), (1.0, 0.2, 0.1, 0.0, 0.1), 1.0),
    "30 % missing": ((10, 3, 1, 3), (1.0, 0.2, 0.0, 0.1, 0.2), 0.7),
    "sessions, 40 % missing": ((8, 3, 3, 2), (1.0, 0.2, 0.1, 0.0, 0.1), 0.6),
    "one tester": ((10, 1, 1, 3), (1.0, 0.0, 0.0, 0.0, 0.2), 1.0),
}


def main() -> None:
    """Print the coverage of each result of each design."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--studies", type=int, default=300)
    studies = parser.parse_args().studies
    random = np.random.default_rng(2)
    for name, (sizes, spreads, kept) in DESIGNS.items():
        grr = float(np.sqrt(sum(sd**2 for sd in spreads[1:])))
        truth = {
            "repeatability": spreads[4],
            "tester": spreads[1],
            "session": spreads[2],
            "GRR": grr,
            "part": spreads[0],
        }
        held: dict[str, list[bool]] = {}
        for _ in range(studies):
            found = gauge_study("split_hz", simulated(random, sizes, spreads, kept))
            for one in found.components:
                if one.name in truth:
                    held.setdefault(one.name, []).append(one.sd.low <= truth[one.name] <= one.sd.high)
            share, whole = found.component("GRR").study, 100.0 * grr / np.hypot(grr, spreads[0])
            held.setdefault("study", []).append(share.low <= whole <= share.high)
            number = 1.41 * spreads[0] / grr
            held.setdefault("categories", []).append(found.categories.low <= number <= found.categories.high)
        print(name, {key: round(float(np.mean(values)), 3) for key, values in held.items()})


if __name__ == "__main__":
    main()
