"""Processor time of `gyroscreen attribute` on stored devices, and the size of the table that it reads.

    python tests/measure/attribute_time.py [--devices 100000]

The run is drawn and judged by its true values (tests/judged_runs.py), as its identification would take two hours.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import resource
import tempfile
import time
from pathlib import Path

from tests.judged_runs import judged_config, judged_run
from workflows.cli import call


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
            started, wall = time.process_time(), time.monotonic()
            with contextlib.redirect_stdout(io.StringIO()):
                code = call(["attribute", "--results", str(folder / "results"), *options])
            spent = f"{time.process_time() - started:.1f} s of processor time, {time.monotonic() - wall:.1f} s"
            memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
            print(f"attribute {' '.join(options)}: {spent}, exit code {code}, {memory:.0f} MB")


if __name__ == "__main__":
    main()
