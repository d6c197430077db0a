"""Processor and wall time of ``gyroscreen report`` on runs of stub devices with a value in every column; the least of three each.

usage: python -m tests.measure.report_time [DEVICES ..]; the default is 12,800 and 998,400.
"""

from __future__ import annotations

import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import tomli_w

from pipeline.store.run import create_run
from tests.measure.report_memory import ROWS, table
from workflows.config import RunConfig, to_toml_table
from workflows.screening.plan import without_none


def seconds_of(command: list[str]) -> tuple[float, float]:
    """Processor time, of all threads together, and wall time of a command [s]."""
    before, started = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    after, wall = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic() - started
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, wall


def main() -> None:
    """Make each run, report it, print the least times."""
    for devices in [int(text) for text in sys.argv[1:]] or [12_800, 998_400]:
        with tempfile.TemporaryDirectory(prefix="gyroscreen-report-") as folder:
            config = tomli_w.dumps(without_none(to_toml_table(RunConfig())))
            store = create_run(Path(folder), "r", config, {"seed": 0})
            for block in range(devices // ROWS):
                store.commit_block(block, table(block * ROWS), None)
            store.finish("complete", {})
            command = [sys.executable, "-m", "workflows.cli", "report", "--results", folder]
            times = [seconds_of([*command, "--out", str(Path(folder) / "page.html")]) for _ in range(3)]
            processor, wall = (min(one) for one in zip(*times, strict=True))
            made = devices // ROWS * ROWS
            print(f"{made} devices: {processor:.2f} s of processor time, {wall:.2f} s of wall time", flush=True)


if __name__ == "__main__":
    main()
