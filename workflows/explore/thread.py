"""A thread for work that the page waits for, and that Ctrl-C does not wait for."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor, Future
from queue import SimpleQueue
from threading import Thread
from typing import Any


class DaemonThread(Executor):
    """One thread that does what is submitted, in order.

    A ``ThreadPoolExecutor`` is joined when the program ends: after Ctrl-C the judgement of a large run, or a fit, would still be
    finished, for nobody.  A daemon thread ends with the program.
    """

    def __init__(self, name: str) -> None:
        self._tasks: SimpleQueue[tuple[Future[Any], Callable[[], Any]]] = SimpleQueue()
        Thread(target=self._work, name=name, daemon=True).start()

    def submit(self, function: Callable[..., Any], /, *arguments: Any, **named: Any) -> Future[Any]:
        """Do ``function`` after all that was submitted before; its result or error goes to the future."""
        found: Future[Any] = Future()
        self._tasks.put((found, lambda: function(*arguments, **named)))
        return found

    def _work(self) -> None:
        while True:
            found, task = self._tasks.get()
            if not found.set_running_or_notify_cancel():
                continue
            try:
                found.set_result(task())
            except BaseException as error:
                found.set_exception(error)
