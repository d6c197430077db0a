"""A process for work that would hold up the page, and that is ended as soon as its answer is of no use.

A thread is not enough for long work: it shares Python's lock with the event loop, and a judgement of 100,000 devices held a page
for 20 s (``tests.measure.explore_drag``).  The process is spawned rather than forked, because the page has threads, and it is
started before there is work, because it takes a second or two to load numpy and the tables' library.

    page  --submit(function, ..)-->  thread  --pipe-->  process       the thread waits for the answer without Python's lock
    page  --stop(future)-->          the process is killed, its successor started
"""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable
from concurrent.futures import Executor, Future
from importlib import import_module
from multiprocessing.connection import Connection
from queue import SimpleQueue
from threading import Lock, Thread
from typing import Any

from pipeline.errors import IncompleteError

#: Steps of priority that the process leaves to the page.
_NICE = 5
_Task = tuple[Future[Any], Callable[..., Any], tuple[Any, ...]]


class StoppableProcess(Executor):
    """One process that does what is submitted, in order; its functions, arguments and results are pickled.

    Parameters
    ----------
    name : of thread and process.
    module : what each new process imports before it is given work.
    """

    def __init__(self, name: str, module: str) -> None:
        self._name, self._module = name, module
        self._tasks: SimpleQueue[_Task] = SimpleQueue()
        self._lock = Lock()
        self._running: Future[Any] | None = None
        self._child: multiprocessing.process.BaseProcess | None = None
        self._thread: Thread | None = None

    def start(self) -> None:
        """Start the process; a second call changes nothing."""
        with self._lock:
            if self._thread is None:
                self._thread = Thread(target=self._work, name=self._name, daemon=True)
                self._thread.start()

    def submit(self, function: Callable[..., Any], /, *arguments: Any, **named: Any) -> Future[Any]:
        """Do ``function`` after all that was submitted before; its result or error goes to the future."""
        if named:
            raise TypeError("arguments are given by position")
        self.start()
        found: Future[Any] = Future()
        self._tasks.put((found, function, arguments))
        return found

    def stop(self, wanted: Future[Any]) -> None:
        """Give ``wanted`` up: it ends as cancelled, or with an error if it has begun."""
        if wanted.cancel():
            return
        with self._lock:
            if self._running is wanted and self._child is not None:
                self._child.kill()
                self._child = None

    def _work(self) -> None:
        answers: Connection | None = self._started()
        while True:
            found, function, arguments = self._tasks.get()
            if not found.set_running_or_notify_cancel():
                continue
            answers = answers or self._started()
            with self._lock:
                self._running = found
            try:
                answers.send((function, arguments))
                done, value = answers.recv()
                lost = False
            except (EOFError, OSError):
                done, value = (
                    False,
                    IncompleteError("the process for this work has ended", next_step="ask for it again"),
                )
                lost = True
            with self._lock:
                self._running = None
                stopped = self._child is None
            if lost or stopped:
                answers.close()
                # Python itself ends the process when the program ends; it must have no successor then.
                answers = self._started() if stopped else None
            if done:
                found.set_result(value)
            else:
                found.set_exception(value)

    def _started(self) -> Connection:
        context = multiprocessing.get_context("spawn")
        own, other = context.Pipe()
        child = context.Process(target=_serve, args=(other, self._module), name=self._name, daemon=True)
        child.start()
        other.close()
        with self._lock:
            self._child = child
        return own


def _serve(requests: Connection, module: str) -> None:
    """The process: answer requests until the other side is gone."""
    # Ctrl-C reaches all processes of the terminal; this one ends with the page.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(os, "nice"):
        os.nice(_NICE)
    import_module(module)
    from threadpoolctl import threadpool_limits

    while True:
        try:
            function, arguments = requests.recv()
        except (EOFError, OSError):
            return
        try:
            with threadpool_limits(limits=1):
                answer = True, function(*arguments)
        except Exception as error:
            answer = False, error
        try:
            requests.send(answer)
        except OSError:
            return
