"""Whether two runs of the same devices, by two versions, give the same answers up to Monte Carlo error.

    python tests/measure/same_devices.py RUN OTHER

For each estimated quantity and device, with medians m, m', standard deviations s, s' of n effective draws each:

    z = (m - m') / (1.2533 s sqrt(2 / n)),   1.2533 = sqrt(pi / 2) from the variance of the median of normal draws
    r = s' / s,   sd(log r) = sqrt(1 / n)

Printed: the share of devices with |z| below the limit of ALPHA over all devices (Bonferroni), the largest |z|, the mean of r with
its standard error, and how many devices have another status or verdict.  Source of the variance: Kendall & Stuart, vol. 1, 10.10.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.stats import norm

#: Probability that any device of a pair of equal versions is outside.
ALPHA = 1e-3


def devices_of(folder: Path) -> pd.DataFrame:
    """The devices of a run, by device_id."""
    files = sorted(folder.glob("devices-*.parquet"))
    if not files:
        sys.exit(f"{folder} holds no devices-*.parquet; give the folder run=... of a run")
    return pd.concat([pd.read_parquet(file) for file in files]).set_index("device_id").sort_index()


def main() -> None:
    """Print the comparison."""
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    one, other = (devices_of(Path(argument)) for argument in sys.argv[1:])
    shared = one.index.intersection(other.index)
    one, other = one.loc[shared], other.loc[shared]
    both = ((one.status == "ok") & (other.status == "ok")).to_numpy()
    print(f"{len(shared)} devices in both runs, {both.sum()} ok in both")
    for column in ("status", "verdict"):
        changed = one[column] != other[column]
        print(f"{column} differs: {int(changed.sum())} {sorted(shared[changed])[:10]}")
    n = np.minimum(one.ess, other.ess).to_numpy()[both]
    limit = float(norm.isf(0.5 * ALPHA / both.sum()))
    for name in [c for c in one if f"{c}_sd" in one and not c.startswith(("true_", "fab_")) and c in other]:
        m, mm, s, ss = (t[c].to_numpy(float)[both] for c in (name, f"{name}_sd") for t in (one, other))
        known = np.isfinite(m) & np.isfinite(mm) & (s > 0.0) & (ss > 0.0)
        if not known.any():
            continue
        difference = m - mm
        if name.startswith("theta"):
            difference = (difference + 90.0) % 180.0 - 90.0
        z = difference[known] / (1.2533 * s[known] * np.sqrt(2.0 / n[known]))
        r = ss[known] / s[known]
        inside, largest, rms = np.mean(np.abs(z) < limit), np.abs(z).max(), np.sqrt(np.mean(z**2))
        print(
            f"{name:26} |z| < {limit:.2f}: {inside:.4f}, largest {largest:.2g}, rms {rms:.2g}; "
            f"mean sd ratio {r.mean():.6f} +- {r.std() / np.sqrt(r.size):.1g}"
        )


if __name__ == "__main__":
    main()
