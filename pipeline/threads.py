"""Work spread over threads: what takes long here (compiled loops, transforms, products) runs free of the lock."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import cache, wraps
from threading import Lock
from typing import TypeVar

In = TypeVar("In")
Out = TypeVar("Out")


def mapped(job: Callable[[In], Out], items: Iterable[In], threads: int) -> list[Out]:
    """``[job(item) for item in items]``, ``threads`` of them at once; raises what the first failing job raised."""
    each = list(items)
    if threads <= 1 or len(each) <= 1:
        return [job(item) for item in each]
    with ThreadPoolExecutor(min(threads, len(each))) as pool:
        return list(pool.map(job, each))


def once(make: Callable[[In], Out]) -> Callable[[In], Out]:
    """``make``, its results kept, called once for an argument however many threads ask: what compiles takes seconds."""
    kept, lock = cache(make), Lock()

    @wraps(make)
    def held(argument: In) -> Out:
        with lock:
            return kept(argument)

    return held
