"""Kills of workers over blocks of stub devices: figures of `gyroscreen benchmark faults`."""

from __future__ import annotations

import random
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import psutil

from pipeline.store.run import create_run

from ..screening.batch import run_blocks
from .driver_kills import DEVICES, stub_plan
from .faults import Stub


def killed_workers(blocks: int, kills: int, seconds: float, workers: int, seed: int) -> dict[str, Any]:
    """Figures of a run of ``blocks`` whose workers are killed at ``kills`` random moments; a device takes ``seconds``."""
    planned = stub_plan(blocks)
    with tempfile.TemporaryDirectory(prefix="gyroscreen-faults-") as folder:
        counted = Path(folder) / "count"
        counted.mkdir()
        store = create_run(Path(folder), "faults", "", {})
        done, killed = threading.Event(), [0]
        expected = blocks * DEVICES * seconds / workers
        random_ = random.Random(seed)
        killer = threading.Thread(target=_kill, args=(done, killed, kills, expected, random_), daemon=True)
        started = time.monotonic()
        killer.start()
        try:
            run_blocks(planned, store, workers, None, True, Stub(seconds, count=counted))
        finally:
            done.set()
            killer.join()
        computed = sum(file.stat().st_size for file in counted.iterdir())
        rows = store.devices()
        ids = rows.column("device_id").to_pylist()
        return {
            "devices": len(ids),
            "each device once": ids == [f"stub-{n:08d}" for n in range(blocks * DEVICES)],
            "workers killed": killed[0],
            "devices lost": rows.column("status").to_pylist().count("lost"),
            "extra devices computed / devices": computed / len(ids) - 1.0,
            "seconds": time.monotonic() - started,
        }


def _kill(done: threading.Event, killed: list[int], kills: int, expected_s: float, random_: random.Random) -> None:
    """Kill a random worker process of this process, ``kills`` times at random intervals."""
    while killed[0] < kills and not done.wait(random_.expovariate(kills / expected_s)):
        own = [one for one in psutil.Process().children() if _is_worker(one)]
        if own:
            random_.choice(own).kill()
            killed[0] += 1


def _is_worker(process: psutil.Process) -> bool:
    try:
        return "worker_process" in " ".join(process.cmdline())
    except psutil.Error:  # it has just ended
        return False
