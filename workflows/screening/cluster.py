"""Work on dask: local processes, or an existing dask cluster.

At most a few items per worker are in flight, and the future of a finished item is released at once, so a worker that is lost
costs only its items in flight.  If no worker is left, the run stops with an error instead of waiting forever.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, TypeVar

import dask
from distributed import Client, LocalCluster, as_completed

from pipeline.errors import IncompleteError, UsageError

from ..interrupts import deaf_children

In = TypeVar("In")
Out = TypeVar("Out")

_IN_FLIGHT = 4
_PATIENCE_S = 60.0
_MEMORY_LIMIT = "2GiB"
_THREADS = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}


@contextmanager
def cluster(workers: int, scheduler: str | None) -> Iterator[Client]:
    """A client of ``scheduler``, or of ``workers`` local processes with one thread each.

    Raises
    ------
    UsageError : the scheduler does not respond.
    """
    if scheduler is not None:
        try:
            client = Client(scheduler, timeout="5s", set_as_default=False)
        except (OSError, TimeoutError, ValueError) as error:
            raise UsageError(
                f"the dask scheduler does not respond ({type(error).__name__})",
                value=scheduler,
                allowed="tcp://host:port of a running scheduler",
                next_step="start one with `dask scheduler`, or run locally without --scheduler",
            ) from None
        try:
            yield client
        finally:
            client.close()
        return
    with dask.config.set({"distributed.worker.preload-nanny": [], "distributed.nanny.pre-spawn-environ": _THREADS}):
        with deaf_children():
            local = LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                processes=True,
                dashboard_address="127.0.0.1:0",
                memory_limit=_MEMORY_LIMIT,
                silence_logs=50,
            )
        with local, Client(local, set_as_default=False) as client:
            yield client


def in_parallel(
    client: Client, function: Callable[..., Out], constant: Any, items: Sequence[In], patience_s: float = _PATIENCE_S
) -> Iterator[Out]:
    """``function(constant, item)`` of every item, in the order of completion.

    Raises
    ------
    IncompleteError : there was no worker for ``patience_s`` seconds.
    """
    waiting = iter(items)
    running: Any = as_completed(loop=client.loop)
    shared = client.scatter(constant, broadcast=True, hash=False)

    def submit() -> bool:
        for item in waiting:
            running.add(client.submit(function, shared, item, pure=False, retries=2))
            return True
        return False

    workers = max(1, len(client.scheduler_info(n_workers=-1)["workers"]))
    for _ in range(_IN_FLIGHT * workers):
        if not submit():
            break
    no_worker_since: float | None = None
    while running.count():
        done = _next_done(running, 1.0)
        if done is not None:
            no_worker_since = None
            result = done.result()
            done.release()
            submit()
            yield result
            continue
        if client.status == "running" and client.scheduler_info(n_workers=-1)["workers"]:
            no_worker_since = None
            continue
        no_worker_since = no_worker_since or time.monotonic()
        if time.monotonic() - no_worker_since > patience_s:
            raise IncompleteError(
                "no worker is left",
                value=f"{patience_s:g} s without a worker",
                allowed="at least one worker",
                next_step="check the logs of the workers (memory), then continue: gyroscreen run --resume latest",
            )


def _next_done(running: Any, timeout_s: float) -> Any:
    """The next finished future, or ``None`` after ``timeout_s``."""
    deadline = time.monotonic() + timeout_s
    while time.monotonic() < deadline:
        if running.has_ready():
            return next(running)
        time.sleep(0.005)
    return None
