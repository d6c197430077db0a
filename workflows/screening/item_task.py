"""One item of ``dispatch`` in a worker."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

from distributed import get_worker

from .guard import guarded
from .worker_process import SIGNS, leave_sign, send_sign


def item_task(
    function: Callable[..., Any], constant: Any, item: Any, key: str, topic: str, limit_s: float | None
) -> Any:
    """One item in a worker: its result, and the duration of each of its devices [s]."""
    if limit_s is None:
        return function(constant, item), ()
    worker, folder = get_worker(), os.environ.get(SIGNS)

    def report(device: int, limit: float) -> None:
        if folder is not None:
            leave_sign(folder, key, device, limit)
        else:
            send_sign(worker, topic, {"key": key, "device": device, "limit": limit})

    seconds: list[float] = []
    with guarded(report, limit_s, seconds) as begin:
        result = function(constant, item, begin)
    return result, seconds
