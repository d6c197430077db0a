"""A dask cluster: local processes, or an existing one.  ``dispatch`` works on it."""

from __future__ import annotations

import gc
import logging
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

import dask
from distributed import Client, LocalCluster

from pipeline.errors import UsageError
from pipeline.input_limits import WORKER_BYTES
from pipeline.store.provenance import DISTRIBUTION, package_versions

from ..process import deaf_children
from .local_workers import LocalWorkers
from .scheduler import Scheduler, UnreachableError

#: How long workers of an existing cluster may take to state their versions [s].
_ANSWER_S = 20.0
#: ``dispatch`` decides what to do with a task whose worker ended, and replaces workers that do not respond.
_LOCAL = {
    "distributed.scheduler.allowed-failures": 0,
    "distributed.scheduler.worker-ttl": None,
}


@contextmanager
def _quiet() -> Iterator[None]:
    """Losses of workers and of the scheduler are reported once, by ``dispatch``, and not by tracebacks of background tasks."""
    loggers = [logging.getLogger(name) for name in ("distributed", "asyncio", "tornado")]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        gc.collect()  # background tasks that failed report when they are collected
        for logger, level in zip(loggers, levels):
            logger.setLevel(level)


@contextmanager
def cluster(workers: int, scheduler: Scheduler | None, memory_bytes: int | None = None) -> Iterator[Client]:
    """A client of ``scheduler``, or of ``workers`` local processes with one thread each.

    A local process that takes more than ``memory_bytes`` is replaced; the default is that of a night.

    Raises
    ------
    UnreachableError : the scheduler does not respond.
    """
    if scheduler is not None:
        with _quiet(), _connected(scheduler) as client:
            yield client
        return
    with _quiet(), dask.config.set(_LOCAL):
        with deaf_children():
            processes = LocalWorkers(workers, memory_bytes or WORKER_BYTES)
        try:
            with deaf_children():
                local = LocalCluster(n_workers=0, processes=True, dashboard_address="127.0.0.1:0", silence_logs=50)
                processes.connect(local.scheduler_address)
            with local, Client(local, set_as_default=False) as client:
                client.local_workers = processes
                yield client
        finally:
            processes.close()


@contextmanager
def _connected(scheduler: Scheduler) -> Iterator[Client]:
    try:
        client = Client(scheduler.address, security=scheduler.security, timeout="5s", set_as_default=False)
    except (OSError, TimeoutError, ValueError, TypeError, RuntimeError) as error:
        raise UnreachableError(
            f"no connection to the dask scheduler ({_reason(error)})",
            value=scheduler.address,
            allowed="tcp://host:port of a running scheduler, or tls://host:port and certificates of its authority",
            next_step="start one with `dask scheduler`, or run locally without --scheduler",
        ) from None
    try:
        _check_workers(client)
        yield client
    finally:
        client.close()


def _check_workers(client: Client) -> None:
    """Check that the workers that are there have this gyroscreen, and warn of other libraries.

    Raises
    ------
    UsageError : a worker has another version of gyroscreen, or none.
    """
    own = package_versions()
    question = {"op": "versions", "packages": list(own)}
    answers: dict[str, Any] = {}
    with suppress(TimeoutError):  # a worker that has stopped does not answer; it is replaced later
        broadcast = client.scheduler.broadcast  # type: ignore[union-attr]
        answers = client.sync(broadcast, msg=question, on_error="ignore", callback_timeout=_ANSWER_S)
    found = {address: answer["packages"] for address, answer in answers.items()}
    wrong = {
        address: its.get(DISTRIBUTION)
        for address, its in found.items()
        if its.get(DISTRIBUTION) != own.get(DISTRIBUTION)
    }
    if wrong:
        address, version = next(iter(wrong.items()))
        raise UsageError(
            f"{len(wrong)} of {len(found)} workers have another gyroscreen than this machine",
            value=f"{address}: {version or 'none'}",
            allowed=f"gyroscreen {own.get(DISTRIBUTION)} on every worker",
            next_step="install it in the environment of the workers, and start them again",
        )
    others = sorted({name for its in found.values() for name, version in own.items() if its.get(name) != version})
    if others:
        text = f"warning: workers have other versions of {', '.join(others)}; the last digits of the table may differ"
        print(text, file=sys.stderr)


def _reason(error: BaseException) -> str:
    """The first cause of a failed connection, in one line; dask tries until its time is over, and reports that."""
    while error.__cause__ is not None:
        error = error.__cause__
    text = " ".join(str(error).split())
    return f"{type(error).__name__}: {text}"[:200] if text else type(error).__name__


def local_workers(client: Client) -> LocalWorkers | None:
    """The worker processes that belong to a client of :func:`cluster`; ``None`` where the cluster is somebody else's."""
    return getattr(client, "local_workers", None)
