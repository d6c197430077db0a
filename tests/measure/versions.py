"""Processor time per device of several versions, in turn: devices of the default run of each, in blocks of eight.

    git worktree add /tmp/before a527106
    python tests/measure/versions.py . /tmp/before

Each version runs in a process of its own, with its own code, configuration and cache of compiled code; the processes take turns.
Of each block the least time over the rounds counts, which other work on the machine disturbs least.  The first version is the
one that the others are compared with.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

#: Devices of a block: all versions take the same.
TOGETHER = 8


def serve(devices: int) -> None:
    """Time every block once for each line that is read; one line of JSON each: seconds of the blocks, least ESS."""
    import time

    from threadpoolctl import threadpool_limits

    from workflows.config import RunConfig
    from workflows.screening.block import DeviceBlock, virtual_block

    config = RunConfig()
    blocks = [DeviceBlock(i, first, TOGETHER) for i, first in enumerate(range(0, devices, TOGETHER))]
    with threadpool_limits(limits=1):
        for _ in sys.stdin:
            times, ess = [], []
            for block in blocks:
                start = time.process_time()
                tables = virtual_block(config, block)
                times.append(time.process_time() - start)
                ess += [one for one in tables.devices.column("ess").to_pylist() if one is not None]
            print(json.dumps([times, min(ess)]), flush=True)


def main() -> None:
    """Print milliseconds per device, ratios and least ESS."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("checkout", nargs="*", type=Path)
    parser.add_argument("--devices", type=int, default=24)
    parser.add_argument("--rounds", type=int, default=8)
    parser.add_argument(
        "--caches", type=Path, help="Folder for the compiled code of the versions, kept for the next time."
    )
    parser.add_argument("--serve", action="store_true", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.serve:
        serve(given.devices)
        return
    with tempfile.TemporaryDirectory() as temporary:
        caches = (given.caches or Path(temporary)).resolve()
        servers = []
        for i, checkout in enumerate(given.checkout):
            own = {
                "PYTHONPATH": str(checkout.resolve()),
                "NUMBA_CACHE_DIR": f"{caches}/{i}",
                "OPENBLAS_NUM_THREADS": "1",
            }
            command = [sys.executable, str(Path(__file__).resolve()), "--serve", "--devices", str(given.devices)]
            servers.append(
                subprocess.Popen(
                    command,
                    cwd=checkout,
                    env=os.environ | own,
                    text=True,
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                )
            )
        found: list[list[list[float]]] = [[] for _ in servers]
        least = [0.0] * len(servers)
        for round_ in range(given.rounds + 1):
            for i, server in enumerate(servers):
                assert server.stdin is not None
                assert server.stdout is not None
                print(flush=True, file=server.stdin)
                times, least[i] = json.loads(server.stdout.readline())
                if round_:  # the first compiles
                    found[i].append(times)
        for server in servers:
            server.communicate("")
    per_device = [1e3 * sum(map(min, zip(*own))) / len(own[0]) / TOGETHER for own in found]
    for checkout, ms, ess in zip(given.checkout, per_device, least):
        print(f"{checkout}: {ms:.2f} ms per device, {ms / per_device[0]:.2f} times the first; least ESS {ess:.0f}")


if __name__ == "__main__":
    main()
