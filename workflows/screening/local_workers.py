"""Worker processes of a local run, kept alive: one that ends, or takes too much memory, is replaced at once.

dask's own nanny does not replace a worker that ends while it starts, which a queued device that crashes makes it do.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from contextlib import suppress
from pathlib import Path

import psutil

from .faults import Ending, Sign
from .worker_process import SIGNS, name_of

_LOOK_S = 0.1
#: A worker that ends sooner than this after its start is not replaced before [s]: its environment may be broken.
_LEAST_LIFE_S = 1.0
#: Looks at which a worker is found stopped (SIGSTOP) before it is ended, 5 s: a batch system that suspends a job stops driver and
#: workers one after the other.  Without it a device that stops its worker holds it until it is silent, four times 60 s.
_STOPPED_LOOKS = 50
_THREADS = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
#: Where the environment does not say otherwise.  One heap of the C library for all threads of a worker, of which one computes,
#: saves 3 MB; its small tables do not need the memory that pyarrow sets aside for its own pool, 4 MB.
_MEMORY = {"MALLOC_ARENA_MAX": "1", "ARROW_DEFAULT_MEMORY_POOL": "system"}


class LocalWorkers:
    """``count`` worker processes, each with one thread and ``memory_bytes`` of memory, which load while the scheduler starts."""

    def __init__(self, count: int, memory_bytes: int) -> None:
        # -P: the working folder is not searched for imports; a pipeline.py of the user would hide the package.
        module = ["-P", "-m", "workflows.screening.worker_process"]
        self._command = [sys.executable, *module, str(memory_bytes), str(os.getpid())]
        self._address = ""
        self._memory_bytes = memory_bytes
        self._ended: dict[str, Ending] = {}
        self._signs = tempfile.TemporaryDirectory(prefix="gyroscreen-")
        self._stopped: Counter[int] = Counter()
        self._done = threading.Event()
        self._processes = [self._start() for _ in range(count)]
        self._started = [time.monotonic()] * count
        self._thread = threading.Thread(target=self._keep, daemon=True)

    def connect(self, address: str) -> None:
        """Give the workers the address of their scheduler, and keep them alive from now on."""
        self._address = address
        for process in self._processes:
            self._tell(process)
        self._thread.start()

    def ending(self, name: str) -> Ending:
        """How the worker ``name`` ended."""
        until = time.monotonic() + 5.0 * _LOOK_S
        while name not in self._ended and time.monotonic() < until:
            time.sleep(0.02)
        return self._ended.get(name, Ending())

    def sign(self, name: str) -> Sign | None:
        """The last sign of life of the worker ``name``."""
        with suppress(OSError, ValueError):
            key, device, limit_s, since = (Path(self._signs.name) / name).read_text().split()
            return Sign(key, int(device), float(limit_s), float(since))
        return None

    def signs(self) -> list[Sign]:
        """The last sign of life of every worker that has left one."""
        found = (self.sign(name_of(process.pid)) for process in self._processes)
        return [sign for sign in found if sign is not None]

    def end(self, name: str) -> None:
        """End the worker ``name``; it is replaced."""
        for process in self._processes:
            if name_of(process.pid) == name:
                process.kill()

    def close(self) -> None:
        """End all workers."""
        self._done.set()
        if self._thread.ident is not None:
            self._thread.join()
        for process in self._processes:
            process.kill()
        for process in self._processes:
            process.wait()
            if process.stdin is not None:
                with suppress(OSError):
                    process.stdin.close()
        self._signs.cleanup()

    def _start(self) -> subprocess.Popen[bytes]:
        debug = bool(os.environ.get("GYROSCREEN_DEBUG"))
        return subprocess.Popen(
            self._command,
            env={
                **_MEMORY,
                **os.environ,
                **_THREADS,
                SIGNS: self._signs.name,
                "PYTHONPATH": os.pathsep.join(path or str(Path.cwd()) for path in sys.path),
            },
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=None if debug else subprocess.DEVNULL,
            start_new_session=True,  # the driver answers Ctrl-C, not the workers
        )

    def _tell(self, process: subprocess.Popen[bytes]) -> None:
        assert process.stdin is not None
        with suppress(OSError):  # it has ended, and is replaced
            process.stdin.write(f"{self._address}\n".encode())
            process.stdin.close()

    def _keep(self) -> None:
        while not self._done.wait(_LOOK_S):
            for i, process in enumerate(self._processes):
                code = process.poll()
                if code is None:
                    self._check(process)
                elif time.monotonic() - self._started[i] > _LEAST_LIFE_S:
                    self._ended.setdefault(name_of(process.pid), Ending(_said(code)))
                    self._processes[i], self._started[i] = self._start(), time.monotonic()
                    self._tell(self._processes[i])

    def _check(self, process: subprocess.Popen[bytes]) -> None:
        """End a process that takes too much memory, or that somebody has stopped."""
        with suppress(psutil.Error):
            found = psutil.Process(process.pid)
            self._stopped[process.pid] = (
                self._stopped[process.pid] + 1 if found.status() == psutil.STATUS_STOPPED else 0
            )
            if found.memory_info().rss > self._memory_bytes:
                self._end(process, f"more memory than the {self._memory_bytes / 2**30:g} GiB of a worker")
            elif self._stopped[process.pid] > _STOPPED_LOOKS:
                self._end(process, f"it was stopped (SIGSTOP) for {_STOPPED_LOOKS * _LOOK_S:g} s")

    def _end(self, process: subprocess.Popen[bytes], why: str) -> None:
        self._ended[name_of(process.pid)] = Ending(why, certain=True)
        process.kill()


def _said(code: int) -> str:
    if code >= 0:
        return f"exit code {code}"
    with suppress(ValueError):
        return f"signal {signal.Signals(-code).name}"
    return f"signal {-code}"
