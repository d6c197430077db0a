"""Devices that stop, crash, loop in compiled code, or take 5 GB: `gyroscreen benchmark faults --injected`."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec

from pipeline.store.run import create_run, open_run

from ..screening.batch import run_blocks
from .driver_kills import DEVICES, stub_plan
from .faults import Stub

KINDS = ("stop", "segfault", "loop", "allocate")


def injected_faults(blocks: int, seconds: float, limit_s: float, workers: int, folder: Path) -> dict[str, Any]:
    """Figures of a run of ``blocks`` with a device of each kind, or of the rest of it where ``folder`` holds one that stopped.

    ``seconds`` is the duration of a device, ``limit_s`` its limit [s].
    """
    planned = stub_plan(blocks)
    run = msgspec.structs.replace(planned.config.run, device_limit_s=limit_s)
    planned = replace(planned, config=msgspec.structs.replace(planned.config, run=run))
    count = blocks * DEVICES
    faulty = {count * (2 * k + 1) // (2 * len(KINDS)): kind for k, kind in enumerate(KINDS)}
    store = open_run(folder, None) if any(folder.glob("run=*")) else create_run(folder, "injected", "", {})
    started = time.monotonic()
    run_blocks(planned, store, workers, None, True, Stub(seconds, faults=faulty))
    rows = store.devices().to_pylist()
    ids = [row["device_id"] for row in rows]
    others = [row for n, row in enumerate(rows) if n not in faulty]
    reasons = {f"reason of {kind}": rows[n]["status_reason"] for n, kind in faulty.items()}
    return {
        "devices": count,
        "each device once": ids == [f"stub-{n:08d}" for n in range(count)],
        "lost": sum(row["status"] == "lost" for row in rows),
        "others as without faults": all(
            row["status"] == "ok" and row["theta_deg"] == (0.37 * int(row["device_id"][5:])) % 90.0 for row in others
        ),
        **reasons,
        "seconds": time.monotonic() - started,
    }
