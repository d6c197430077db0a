"""Memory that closing a run and its report take: a run of DEVICES stub devices with a value in every column, made and reported.

usage: python -m tests.measure.report_memory DEVICES; prints the peak of the process before and after each step [MB].
"""

from __future__ import annotations

import resource
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pyarrow as pa
import tomli_w

from pipeline.store.run import RunStore, create_run
from pipeline.store.schema import devices_schema
from pipeline.store.verify import verify
from workflows.config import RunConfig, to_toml_table
from workflows.screening.outcome import rendered_report
from workflows.screening.plan import without_none

ROWS = 12_800
# The 100 devices of a wafer: dies of 8 mm pitch.
_DIE = {"die_x_mm": 8.0 * (np.arange(100) % 10) - 36.0, "die_y_mm": 8.0 * (np.arange(100) // 10) - 36.0}


def table(first: int) -> pa.Table:
    """``ROWS`` devices from number ``first`` on."""
    random = np.random.default_rng(first)
    number = np.arange(first, first + ROWS)
    text = {
        "device_id": [f"device-{n:09d}" for n in number],
        "lot": [f"L{n // 100_000}" for n in number],
        "wafer": [f"W{n // 100}" for n in number],
        "status": np.where(random.random(ROWS) < 0.99, "ok", "misfit").tolist(),
        "verdict": random.choice(["pass", "fail", "undecided"], ROWS, p=[0.55, 0.4, 0.05]).tolist(),
    }
    columns = []
    for field in devices_schema():
        if field.name in text:
            columns.append(pa.array(text[field.name]))
        elif field.name in _DIE:
            columns.append(pa.array(_DIE[field.name][number % 100]))
        elif field.name.startswith("p_pass"):
            columns.append(pa.array(np.where(random.random(ROWS) < 0.9, 1.0, random.random(ROWS))))
        elif pa.types.is_floating(field.type):
            columns.append(pa.array(random.normal(1.0, 0.1, ROWS)).cast(field.type))
        else:
            columns.append(pa.nulls(ROWS, field.type))
    return pa.table(columns, schema=devices_schema())


def main() -> None:
    """Make a run, close it, report it."""
    devices = int(sys.argv[1]) // ROWS * ROWS
    with tempfile.TemporaryDirectory(prefix="gyroscreen-report-") as folder:
        config = tomli_w.dumps(without_none(to_toml_table(RunConfig())))
        store: RunStore = create_run(Path(folder), "r", config, {"seed": 0})
        for block in range(devices // ROWS):
            store.commit_block(block, table(block * ROWS), None)
        size = sum(path.stat().st_size for path in store.folder.iterdir())
        print(
            f"{devices} devices, {size / 1e6:.0f} MB of files, values {8 * len(devices_schema()) * devices / 1e6:.0f} MB"
        )
        for name, work in (
            ("made", lambda: None),
            ("finish", lambda: store.finish("complete", {})),
            ("verify", lambda: verify(Path(folder)).require()),
            ("report", lambda: rendered_report(Path(folder), "r")),
        ):
            started = time.process_time()
            work()
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
            print(
                f"{name:8s} peak {peak:7.0f} MB, {time.process_time() - started:6.1f} s of processor time", flush=True
            )


if __name__ == "__main__":
    main()
