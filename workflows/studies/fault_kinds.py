"""What a device may do to its worker, on demand; imports nothing, so that a worker that ended is replaced within a second."""

from __future__ import annotations

import ctypes
import itertools
import os
import signal
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence

_CHUNK, _CHUNKS = 2**27, 40


def _segfault() -> None:
    ctypes.string_at(0)


def _loop() -> None:
    """An endless loop in compiled code that holds the interpreter."""
    deque(itertools.repeat(None), maxlen=0)


def _allocate() -> None:
    """Takes 5 GB within a second."""
    held = []
    for _ in range(_CHUNKS):
        held.append(bytearray(b"x") * _CHUNK)
        time.sleep(0.02)


def _raise() -> None:
    raise KeyError("a defect of the program")


def _die() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def _stop() -> None:
    os.kill(os.getpid(), signal.SIGSTOP)


def _slow() -> None:
    time.sleep(0.5)


FAULTS: Mapping[str, Callable[[], None]] = {
    "segfault": _segfault,
    "loop": _loop,
    "allocate": _allocate,
    "raise": _raise,
    "slow": _slow,
    "die": _die,
    "stop": _stop,
}


def faulty_numbers(faults: Mapping[int, str], numbers: Sequence[int], begin: Callable[[int], None]) -> list[int]:
    """The squares of ``numbers``, as a task of ``guarded_in_parallel``; each number may have a fault."""
    out = []
    for number in numbers:
        begin(number)
        if number in faults:
            FAULTS[faults[number]]()
        out.append(number * number)
    return out
