"""Work in threads.  Compiled loops, transforms and matrix products release the interpreter lock, so they run in parallel."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import cache, wraps
from threading import Lock
from typing import TypeVar, TypeVarTuple

In = TypeVar("In")
Out = TypeVar("Out")
Given = TypeVarTuple("Given")


def usable_cores() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def mapped(job: Callable[[In], Out], items: Iterable[In], threads: int) -> list[Out]:
    """``[job(item) for item in items]`` with ``threads`` jobs at once; raises the error of the first item that fails."""
    each = list(items)
    if threads <= 1 or len(each) <= 1:
        return [job(item) for item in each]
    with ThreadPoolExecutor(min(threads, len(each))) as pool:
        return list(pool.map(job, each))


def once(make: Callable[[*Given], Out]) -> Callable[[*Given], Out]:
    """``make`` with a cache: one call for the same arguments, even if several threads request it at the same time.

    For functions that compile code, which takes seconds.
    """
    cached, lock = cache(make), Lock()

    @wraps(make)
    def locked(*given: *Given) -> Out:
        with lock:
            return cached(*given)

    return locked
