"""Number of workers and memory settings of the process."""

from __future__ import annotations

import ctypes

from pipeline.errors import UsageError
from pipeline.threads import usable_cores

#: mallopt parameters of glibc (malloc.h): trim and mmap thresholds, padding of the heap [bytes], number of arenas.
_MALLOPT = {-1: 1 << 30, -3: 1 << 30, -2: 1 << 26, -8: 1}


def worker_count(wanted: int) -> int:
    """``wanted`` workers, or one per usable core if it is 0; UsageError if it is negative."""
    if wanted < 0:
        raise UsageError("invalid number of workers", value=wanted, allowed="1 or more, or 0 for one per core")
    return wanted or usable_cores()


def keep_memory() -> None:
    """Keep freed memory in the process: returning pages to the system and requesting them again costs 10 % of the time.

    Changes settings of the whole process; does nothing if the C library is not glibc.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError, TypeError):
        return
    for parameter, value in _MALLOPT.items():
        mallopt(parameter, value)
