"""Small deterministic runs for the tests of the store: block k depends on (seed, k) alone."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa

from pipeline.quantities import MODEL
from pipeline.store.run import RunStore, create_run
from pipeline.store.schema import devices_table, posterior_table

CONFIG = "seed = 7\n"
PROVENANCE = {"seed": 7, "versions": {"gyroscreen": "0"}, "git_revision": None}
ROWS, DRAWS = 4, 5


def block_tables(block: int, seed: int = 7) -> tuple[pa.Table, pa.Table]:
    """Tables of one block: ROWS devices with DRAWS draws each."""
    rng = np.random.default_rng([seed, block])
    ids = [f"{block * ROWS + row:06d}" for row in range(ROWS)]
    devices = devices_table(
        {
            "device_id": ids,
            "theta_deg": rng.normal(size=ROWS),
            "split_hz": [np.nan, *rng.uniform(0.1, 3.0, ROWS - 1)],
            "verdict": ["pass", "fail", "undecided", None],
        }
    )
    posterior = posterior_table(
        {
            "device_id": np.repeat(ids, DRAWS),
            "draw": np.tile(np.arange(DRAWS), ROWS),
            **{quantity.name: rng.normal(size=ROWS * DRAWS) for quantity in MODEL},
        }
    )
    return devices, posterior


def make_run(results: Path, run_id: str, blocks: tuple[int, ...] = (0, 1, 2), seed: int = 7) -> RunStore:
    """A complete run with a page."""
    store = create_run(results, run_id, CONFIG, PROVENANCE)
    for block in blocks:
        store.commit_block(block, *block_tables(block, seed))
    store.write_file("report.html", b"<p>report</p>")
    store.finish("complete", {"devices": ROWS * len(blocks)})
    return store
