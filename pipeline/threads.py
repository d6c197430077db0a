"""Work spread over threads: what takes long here (compiled loops, transforms, products) runs free of the lock."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
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
