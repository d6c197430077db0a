"""gyroscreen benchmark."""

from __future__ import annotations

import json as json_
import resource
import sys
import tempfile
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from populations.draw import draw

from ..config import load_config
from ..process import worker_count
from ..screening.block import DeviceBlock, virtual_block
from ..screening.settings import population
from ..screening.virtual_device import identify_virtual
from ..studies.commit_cost import commits as cost_of_commits
from ..studies.coverage import Share, figures, run_study
from ..studies.driver_kills import killed_drivers
from ..studies.fault_study import killed_workers
from ..studies.injected import injected_faults
from ..studies.near_limits import DeviceShare

#: Time limit of an injected device [s]: a stub takes less than a second, but a busy machine needs 6 s to fill 2 GiB.
_LIMIT_S = 20.0


def coverage(devices: int, splits: str, noise: str, bad: float, seed: int, workers: int, json: bool) -> None:
    """See ``gyroscreen benchmark coverage --help``."""
    show(figures(run_study(devices, splits, seed, workers, noise, bad)), json)


def faults(
    blocks: int,
    kills: int,
    seconds: float,
    commits: int,
    driver_kills: int,
    injected: int,
    out: Path | None,
    seed: int,
    workers: int,
    json: bool,
) -> None:
    """See ``gyroscreen benchmark faults --help``."""
    count = worker_count(workers)
    found = killed_workers(blocks, kills, seconds, count, seed) if blocks and kills else {}
    with tempfile.TemporaryDirectory(prefix="gyroscreen-faults-") as temporary:
        folder = out or Path(temporary)
        if blocks and driver_kills:
            found |= killed_drivers(blocks, driver_kills, seconds, count, seed, folder / "kills")
        if injected:
            found |= injected_faults(injected, seconds, _LIMIT_S, count, folder / "injected")
        if commits:
            found |= cost_of_commits(commits, folder / "commits")
    show(found, json)


def follow(progress: Iterable[tuple[int, int]], what: str) -> None:
    """Run a study that yields (done, total), and show how many of ``what`` are done."""
    for done, total in progress:
        print(f"\r{done} of {total} {what}", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)


def show(found: dict[str, Any], json: bool) -> None:
    """Print figures by name, as lines or as one JSON object."""
    if json:
        print(json_.dumps({name: _plain(value) for name, value in found.items()}))
        return
    for name, value in found.items():
        print(f"{name:58s} {value:.3f}" if isinstance(value, float) else f"{name:58s} {value}")


def _plain(value: Any) -> Any:
    if isinstance(value, Share | DeviceShare):
        return {"count": value.count, "total": value.total, "interval": list(value.interval)}
    return value


def throughput(devices: int, json: bool) -> None:
    """See ``gyroscreen benchmark throughput --help``."""
    config = load_config(None, {"devices": devices})
    virtual_block(config, DeviceBlock(0, 0, 2))  # loads compiled code and shared transforms, as each worker does once
    spec = population(config)
    gain = float(spec.angular_gain)
    with threadpool_limits(limits=1):
        wall, cpu = time.perf_counter(), time.process_time()
        drawn = draw(spec, config.run.seed, 0, devices)
        ess = [identify_virtual(config, drawn, i, gain).columns.get("ess") for i in range(devices)]
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    show(
        {
            "devices": devices,
            "devices/s of wall time": devices / wall,
            "devices/s of CPU time": devices / cpu,
            "least ESS": min(float(e) for e in ess if isinstance(e, float)),
            "peak memory of the process, MB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0,
        },
        json,
    )
