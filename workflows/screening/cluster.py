"""Blocks on dask: local processes, or a cluster that somebody else runs.

At most a few blocks a worker are in flight; a finished block is handed over and its future released at once, so a lost
worker costs what was in flight and nothing that was done.  Workers that vanish for good end the run instead of hanging it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, TypeVar

import dask
from distributed import Client, LocalCluster, as_completed

from pipeline.errors import IncompleteError, UsageError

In = TypeVar("In")
Out = TypeVar("Out")

_IN_FLIGHT = 4
_PATIENCE_S = 60.0
_MEMORY_LIMIT = "2GiB"
_THREADS = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}


@contextmanager
def cluster(workers: int, scheduler: str | None) -> Iterator[Client]:
    """A client of ``scheduler``, or of ``workers`` local processes of one thread each.

    Raises
    ------
    UsageError : the scheduler does not answer.
    """
    if scheduler is not None:
        try:
            client = Client(scheduler, timeout="5s", set_as_default=False)
        except (OSError, TimeoutError, ValueError) as error:
            raise UsageError(
                f"the dask scheduler does not answer ({type(error).__name__})",
                value=scheduler,
                allowed="tcp://host:port of a running scheduler",
                next_step="start one with `dask scheduler`, or leave --scheduler out to run locally",
            ) from None
        try:
            yield client
        finally:
            client.close()
        return
    with (
        dask.config.set({"distributed.worker.preload-nanny": [], "distributed.nanny.pre-spawn-environ": _THREADS}),
        LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            processes=True,
            dashboard_address="127.0.0.1:0",
            memory_limit=_MEMORY_LIMIT,
            silence_logs=50,
        ) as local,
        Client(local, set_as_default=False) as client,
    ):
        yield client


def in_parallel(
    client: Client, function: Callable[..., Out], constant: Any, items: Sequence[In], patience_s: float = _PATIENCE_S
) -> Iterator[Out]:
    """``function(constant, item)`` of every item, in the order in which they are done.

    Raises
    ------
    IncompleteError : no worker was left for ``patience_s`` seconds.
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
    alone_since: float | None = None
    while running.count():
        done = _next_done(running, 1.0)
        if done is not None:
            alone_since = None
            result = done.result()
            done.release()
            submit()
            yield result
            continue
        if client.status == "running" and client.scheduler_info(n_workers=-1)["workers"]:
            alone_since = None
            continue
        alone_since = alone_since or time.monotonic()
        if time.monotonic() - alone_since > patience_s:
            raise IncompleteError(
                "no worker is left",
                value=f"{patience_s:g} s without one",
                next_step="look at the workers' logs (memory?), then go on with: gyroscreen run --resume",
            )


def _next_done(running: Any, timeout_s: float) -> Any:
    """The next finished future, or ``None`` after ``timeout_s``."""
    deadline = time.monotonic() + timeout_s
    while time.monotonic() < deadline:
        if running.has_ready():
            return next(running)
        time.sleep(0.005)
    return None
