"""What this machine offers."""

from __future__ import annotations

import os


def worker_count(wanted: int) -> int:
    """``wanted`` workers, or one a usable core where it is 0."""
    if wanted:
        return wanted
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
