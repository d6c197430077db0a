"""The guard of a device in its worker: a sign of life at its start, and a time limit that also ends loops in compiled code.

The limit is the timer of ``faulthandler``: a thread of the C library ends the process, whether or not compiled code holds the
interpreter.  dask then replaces the worker.  The timer is one per process, so it is set to the earliest limit of all threads.
"""

from __future__ import annotations

import faulthandler
import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

#: Called with the number of a device before it starts.
Begin = Callable[[int], None]

#: The first device of a process also loads, or compiles, the code: it may take so many limits.
FIRST = 3.0
#: Pause before it [s]: the sign of life leaves the process, and its nanny learns that it has started, before it can crash.
_SETTLE_S = 0.3


def unguarded(_: int) -> None:
    """The start of a device that nobody watches."""


class _Timer:
    """The timer of the process: a limit for each thread that works on a device."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._until: dict[int, float] = {}
        self._sink: Any = None
        self.fresh = True

    def set(self, limit_s: float | None) -> None:
        """The limit of this thread from now on [s]; ``None``: no limit."""
        with self._lock:
            self._until.pop(threading.get_ident(), None)
            if limit_s is not None:
                self._until[threading.get_ident()] = time.monotonic() + limit_s
            faulthandler.cancel_dump_traceback_later()
            if self._until:
                self._sink = self._sink or Path(os.devnull).open("w")  # noqa: SIM115 (faulthandler keeps its descriptor)
                left = max(min(self._until.values()) - time.monotonic(), 0.01)
                faulthandler.dump_traceback_later(left, exit=True, file=self._sink)


_TIMER = _Timer()


@contextmanager
def guarded(report: Callable[[int, float], None], limit_s: float, seconds: list[float]) -> Iterator[Begin]:
    """The start function of a series of devices.

    Parameters
    ----------
    report : called with the number of a device and its limit [s] before it starts.
    limit_s : time limit of a device [s]; a device that exceeds it ends the process.
    seconds : receives the duration of each device [s].
    """
    started: float | None = None

    def begin(device: int) -> None:
        nonlocal started
        now = time.monotonic()
        if started is not None:
            seconds.append(now - started)
            _TIMER.fresh = False
        started = now
        limit = limit_s * (FIRST if _TIMER.fresh else 1.0)
        report(device, limit)
        _TIMER.set(limit)
        if _TIMER.fresh:
            time.sleep(_SETTLE_S)

    try:
        yield begin
    finally:
        _TIMER.set(None)
    if started is not None:
        seconds.append(time.monotonic() - started)
        _TIMER.fresh = False
