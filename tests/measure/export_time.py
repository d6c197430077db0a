"""Time and memory of exports of large runs: `python tests/measure/export_time.py [DEVICES] [FORMAT..]`.

The run has the rows of a real one, drawn again and again with other numbers; each export is a process of its own.
"""

import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from pipeline.quantities import MODEL
from pipeline.store.run import create_run
from pipeline.store.schema import devices_table

_BLOCK = 12_800
_REPORT = "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, file=sys.stderr); sys.exit(code)"


def stored_run(results: Path, devices: int) -> None:
    """A run of ``devices`` devices with values, sds, intervals and places; no draws."""
    store = create_run(results, "large", "[run]\n", {"seed": 1, "versions": {"gyroscreen": "0.1.0"}})
    random = np.random.default_rng(1)
    for block, first in enumerate(range(0, devices, _BLOCK)):
        n = min(_BLOCK, devices - first)
        numbers = np.arange(first, first + n)
        columns: dict = {
            "device_id": [f"D{k:07d}" for k in numbers],
            "lot": [f"L{k % 5:02d}" for k in numbers],
            "wafer": [f"L{k % 5:02d}-W{k // 5 % 25:02d}" for k in numbers],
            "die_x_mm": 0.8 * (numbers // 125 % 90 - 45),
            "die_y_mm": 0.8 * (numbers // 11250 - 45),
            "p_pass": random.uniform(0.0, 1.0, n),
            "status": ["ok"] * n,
        }
        columns["verdict"] = np.where(columns["p_pass"] > 0.95, "pass", "fail").tolist()
        for quantity in MODEL:
            value = random.normal(1.0, 0.1, n)
            columns |= {quantity.name: value, f"true_{quantity.name}": value + random.normal(0.0, 0.01, n)}
            columns |= {f"{quantity.name}{end}": value + shift for end, shift in (("_q05", -0.02), ("_q95", 0.02))}
            columns[f"{quantity.name}_sd"] = np.full(n, 0.01)
        store.commit_block(block, devices_table(columns), None)
    store.finish("complete", {})


def main(devices: int, formats: tuple[str, ...]) -> None:
    """Print processor time, peak memory of the process, and size of the files."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        stored_run(folder / "results", devices)
        print(f"{devices} devices")
        for chosen in formats:
            out = folder / chosen / "night.out"
            arguments = ["export", "--results", str(folder / "results"), "--format", chosen, "--out", str(out)]
            code = f"import resource, sys; from workflows.cli import call; code = call({arguments!r}); {_REPORT}"
            before, started = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime, time.monotonic()
            done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
            used = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before
            size = sum(file.stat().st_size for file in out.parent.iterdir()) / 1e6
            memory = int(done.stderr.split()[-1]) / 1024
            elapsed = time.monotonic() - started
            print(
                f"{chosen:14s} {used:6.1f} s of processor, {elapsed:6.1f} s, {memory:5.0f} MB of memory, {size:.0f} MB of files"
            )


if __name__ == "__main__":
    asked = sys.argv[1:] or ["100000"]
    main(int(asked[0]), tuple(asked[1:]) or ("csv", "stdf", "wafermap-csv", "wafermap-png"))
