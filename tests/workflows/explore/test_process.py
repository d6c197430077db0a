"""The process for long work: it answers in order, is stopped, and is replaced."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator
from concurrent.futures import CancelledError

import pytest

from pipeline.errors import IncompleteError, UsageError
from workflows.explore.process import StoppableProcess


@pytest.fixture(scope="module")
def process() -> Iterator[StoppableProcess]:
    found = StoppableProcess("test", "math")
    found.start()
    yield found
    found.submit(os._exit, 0)


def fail(what: str) -> None:
    raise UsageError(what, value=3, next_step="nothing")


def test_it_works_elsewhere_and_leaves_the_processor_to_the_page(process: StoppableProcess) -> None:
    assert process.submit(os.getpid).result(60) != os.getpid()
    assert process.submit(os.nice, 0).result(60) > os.nice(0)
    # Ctrl-C in the terminal reaches it too; it is the page that ends.
    process.submit(signal.raise_signal, signal.SIGINT).result(60)
    assert [process.submit(abs, -k) for k in range(3)][2].result(60) == 2


def test_errors_come_back_as_they_were(process: StoppableProcess) -> None:
    with pytest.raises(UsageError, match="wrong: 3; next: nothing"):
        process.submit(fail, "wrong").result(60)
    assert process.submit(abs, -1).result(60) == 1


def test_what_is_stopped_ends_at_once_and_what_waits_never_begins(process: StoppableProcess) -> None:
    first = process.submit(os.getpid).result(60)
    long, waiting = process.submit(time.sleep, 300), process.submit(time.sleep, 300)
    while not long.running():
        time.sleep(0.01)
    process.stop(waiting)
    process.stop(long)
    with pytest.raises(IncompleteError):
        long.result(60)
    with pytest.raises(CancelledError):
        waiting.result(60)
    assert process.submit(os.getpid).result(60) != first
    process.stop(long)
    assert process.submit(abs, -4).result(60) == 4


def test_a_process_that_dies_is_replaced(process: StoppableProcess) -> None:
    with pytest.raises(IncompleteError, match="the process for this work has ended"):
        process.submit(os._exit, 1).result(60)
    assert process.submit(abs, -5).result(60) == 5
