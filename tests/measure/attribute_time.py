"""Processor time of `gyroscreen attribute` on stored devices, and the size of the table that it reads.

    python tests/measure/attribute_time.py [--devices 100000]

The run is drawn and judged by its true values (tests/judged_runs.py), as its identification would take two hours.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from tests.judged_runs import judged_config, judged_run


def main() -> None:
    """Print seconds of processor time, kilobytes per device, and the largest memory."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--devices", type=int, default=100_000)
    devices = parser.parse_args().devices
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        judged_run(folder / "results", judged_config(folder, devices), block=1000)
        sizes = {
            kind: sum(path.stat().st_size for path in folder.glob(f"results/run=*/{kind}-*.parquet"))
            for kind in ("devices", "irregularities")
        }
        print({kind: f"{size / devices:.0f} bytes a device" for kind, size in sizes.items()})
        for options in (["--what-if", "damping_anisotropy.die*0.5"], []):
            started, before = time.monotonic(), resource.getrusage(resource.RUSAGE_CHILDREN)
            command = [sys.executable, "-c", "from workflows.cli import main; main()", "attribute", *options]
            done = subprocess.run([*command, "--results", str(folder / "results")], stdout=subprocess.DEVNULL)
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
            took = f"{spent:.1f} s of processor time, {time.monotonic() - started:.1f} s"
            # The largest of all children so far.
            print(
                f"attribute {' '.join(options)}: {took}, exit code {done.returncode}, {after.ru_maxrss / 1024:.0f} MB"
            )


if __name__ == "__main__":
    main()
