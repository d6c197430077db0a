"""Shares of stored devices by other packages, on nested rows: SALib (pip install SALib) beside given_data_shares.

    python tests/measure/attribution_peers.py [--lots 10] [--repeats 20]

The truth is known: y = 0.5 lot + 0.3 wafer + 0.7 die + 0.4 die, and a number of the lot and one of the die that do nothing.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from pipeline.arrays import FloatArray, IntArray
from reports.attribution.given_data import LEAST_LOTS, given_data_shares
from reports.attribution.shapley import shapley_shares

SIZES = np.array([0.5, 0.0, 0.3, 0.7, 0.4, 0.0])
NAMES = ["lot", "lot, idle", "wafer", "die 1", "die 2", "die, idle"]


def nested(random: np.random.Generator, lots: int) -> tuple[IntArray, FloatArray]:
    """Lot of each of 40 devices a lot, and its numbers (N, 6)."""
    n = 40 * lots
    lot, wafer = np.arange(n) // 40, np.arange(n) // 20
    of_lot = random.standard_normal((2, lots))[:, lot]
    return lot, np.stack([*of_lot, random.standard_normal(2 * lots)[wafer], *random.standard_normal((3, n))], axis=1)


def main() -> None:
    """Print the mean and the sd of the share of each number, by estimator, for a sum and for its exceedance of 1.3."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--lots", type=int, default=40)
    parser.add_argument("--repeats", type=int, default=20)
    given = parser.parse_args()
    started = time.process_time()
    from SALib.analyze import delta, rbd_fast, shapley
    from SALib.sample import shapley as shapley_sample

    print(f"import of SALib: {time.process_time() - started:.2f} s of processor time")
    problem = {"num_vars": 6, "names": NAMES, "bounds": [[-4.0, 4.0]] * 6}
    random = np.random.default_rng(1)
    # SALib's Shapley estimate follows the same paper, for single numbers and one output: it must agree where both apply.
    normal = {"num_vars": 6, "names": NAMES, "bounds": [[0.0, 1.0]] * 6, "dists": ["norm"] * 6}
    x = shapley_sample.sample(normal, 4096, seed=1)
    theirs = shapley.analyze(normal, x, (x @ SIZES > 1.3).astype(float))
    ours = shapley_shares(lambda z: (z @ SIZES > 1.3).astype(float)[:, None], np.arange(6), 4096, 2)
    spread = np.hypot(ours.sd[:, 0], theirs["shapley_normalized_conf"] / 1.96)
    print("Shapley of the loss, SALib", theirs["shapley_normalized"].round(3), "here", ours.value[:, 0].round(3))
    print(
        "difference over its sd",
        ((ours.value[:, 0] - theirs["shapley_normalized"]) / np.maximum(spread, 1e-12)).round(2),
    )
    print("truth of the sum", (SIZES**2 / np.sum(SIZES**2)).round(3))
    for name, output in (("sum", lambda z: z @ SIZES), ("loss", lambda z: (z @ SIZES > 1.3).astype(float))):
        found: dict[str, list[FloatArray]] = {}
        for _ in range(given.repeats):
            lot, z = nested(random, given.lots)
            y = output(z)
            found.setdefault("rbd_fast S1", []).append(rbd_fast.analyze(problem, z, y, num_resamples=2)["S1"])
            found.setdefault("delta S1", []).append(delta.analyze(problem, z, y, num_resamples=2, method="sobol")["S1"])
            if given.lots >= LEAST_LOTS:
                own = given_data_shares(z, np.arange(6), lot, y[:, None]).value[:6, 0]
                found.setdefault("given_data_shares", []).append(own)
        for estimator, shares in found.items():
            mean, sd = np.mean(shares, axis=0).round(3), np.std(shares, axis=0).round(3)
            print(f"{name}, {estimator}: {dict(zip(NAMES, zip(mean.tolist(), sd.tolist())))}, sum {mean.sum():.2f}")


if __name__ == "__main__":
    main()
