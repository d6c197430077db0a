"""A worker process of a local run: ``python -m workflows.screening.worker_process MEMORY_BYTES DRIVER_PID``.

It loads the numerical code, and reads the address of its scheduler from stdin.
"""

from __future__ import annotations

import asyncio
import ctypes
import os
import signal
import sys
import time
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any

import dask
from distributed import Worker
from distributed.utils import sync

#: Environment variable that names the folder where the workers of a local run leave their signs of life.
SIGNS = "GYROSCREEN_SIGNS"
_PR_SET_PDEATHSIG = 1
#: What almost every task imports.
_CODE = "workflows.screening.parts"
#: How long a device waits for a scheduler that does not answer [s].
_SIGN_S = 5.0
#: The driver ends a worker that takes too much memory; nothing is written to disk, and no worker waits for memory.
_MEMORY = {f"distributed.worker.memory.{key}": False for key in ("target", "spill", "pause", "terminate")}
#: Nobody looks at the profile of a worker, which is sampled a hundred times a second, or at its web pages: 8 MB without them.
_UNWATCHED = {"distributed.worker.profile.enabled": False, "distributed.worker.http.routes": []}


def name_of(pid: int) -> str:
    """Name of the worker with this process id."""
    return f"local-{pid}"


def leave_sign(folder: str, key: str, device: int, limit_s: float) -> None:
    """State in the worker's file which device starts; a message would wait for the interpreter, which the device may hold."""
    # Without it a device that ends its worker is found by division; a full disk must not cost every device.
    with suppress(OSError):
        (Path(folder) / name_of(os.getpid())).write_text(f"{key} {device} {limit_s} {time.monotonic()}")


def send_sign(worker: Worker, topic: str, sign: dict[str, Any]) -> None:
    """Tell the scheduler under ``topic`` which device starts, and wait until it knows: the device may hold the interpreter."""
    # A scheduler that is lost is the driver's matter.
    with suppress(OSError, TimeoutError, RuntimeError):
        sync(worker.loop, worker.scheduler.log_event, topic=topic, msg=sign, callback_timeout=_SIGN_S)


async def _serve(address: str, memory_bytes: int) -> None:
    worker = Worker(address, nthreads=1, memory_limit=memory_bytes, name=name_of(os.getpid()), dashboard=False)
    async with worker:
        await worker.finished()


def main() -> None:
    """Work until the scheduler is gone; end with the driver, even if that is killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != int(sys.argv[2]):  # killed before the call, while this process was still importing
            return
    with dask.config.set({**_MEMORY, **_UNWATCHED, "distributed.worker.daemon": False}):
        import_module(_CODE)
        address = sys.stdin.readline().strip()
        if address:  # else the driver has ended
            asyncio.run(_serve(address, int(sys.argv[1])))


if __name__ == "__main__":
    main()
