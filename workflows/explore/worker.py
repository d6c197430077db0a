"""Heavy work of the interactive page: one thread for the whole process, so that the page stays responsive.

Fits are kept by what makes them, which only one thread may use at a time; sessions therefore share the thread.  A session asks
for work under a key: a later request of the same key takes the place of an earlier one that has not begun, and the answer of an
earlier one that has begun is dropped.  Fits themselves are kept, so that nothing is computed twice.

    session  --ask(key, work, done)-->  thread  --next tick of the document-->  done(answer)
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from functools import cache
from typing import TYPE_CHECKING, TypeVar

from threadpoolctl import threadpool_limits

from pipeline.errors import GyroscreenError, printable
from pipeline.user_code import fault_of
from reports.words.explore_loop import DEFECT, WAITING

from ..learning.progress import heard
from .thread import DaemonThread

if TYPE_CHECKING:
    from bokeh.document import Document

T = TypeVar("T")
_LOG = logging.getLogger(__name__)


@cache
def _thread() -> DaemonThread:
    """The thread of the process; it is made when it is first needed."""
    return DaemonThread("explore")


class Session:
    """The requests of one document.  It belongs to the document and is used by its callbacks only.

    Parameters
    ----------
    document : of the session; answers arrive in its callbacks.
    told : is called with a line that says what is being done, and with "" when nothing is.
    failed : is called with one line that says why a request failed.
    """

    def __init__(self, document: Document, told: Callable[[str], None], failed: Callable[[str], None]) -> None:
        self._document = document
        self._told = told
        self._failed = failed
        self._latest: dict[str, int] = {}
        self._open = 0
        self._closed = False
        document.on_session_destroyed(self._close)

    @property
    def busy(self) -> bool:
        """Whether an answer is awaited."""
        return self._open > 0

    def ask(self, key: str, work: Callable[[], T], done: Callable[[T], None]) -> None:
        """Run ``work`` on the thread; ``done`` gets its answer unless a later request has the same ``key``."""
        number = self._latest.get(key, 0) + 1
        self._latest[key] = number
        self._open += 1
        self._told(WAITING)
        _thread().submit(self._run, key, number, work, done)

    def cancel(self, key: str) -> None:
        """Drop the answers of all requests with this ``key``."""
        self._latest[key] = self._latest.get(key, 0) + 1

    def _run(self, key: str, number: int, work: Callable[[], T], done: Callable[[T], None]) -> None:
        if self._closed:
            return
        if self._latest[key] != number:
            self._next(lambda: self._finish(None))
            return
        try:
            with threadpool_limits(limits=1), heard(lambda text: self._next(lambda: self._told(text))):
                found = work()
        except Exception as error:
            line = line_of(error)
            self._next(lambda: self._finish(lambda: self._failed(line) if self._latest[key] == number else None))
        else:
            self._next(lambda: self._finish(lambda: done(found) if self._latest[key] == number else None))

    def _finish(self, then: Callable[[], None] | None) -> None:
        self._open -= 1
        try:
            if then is not None:
                then()
        finally:
            # What was shown may have asked for more.
            if not self._open:
                self._told("")

    def _next(self, call: Callable[[], None]) -> None:
        if not self._closed:
            self._document.add_next_tick_callback(call)

    def _close(self, _: object) -> None:
        self._closed = True


def line_of(error: Exception) -> str:
    """An error as the command line prints it: one line, without a traceback."""
    own = error if isinstance(error, GyroscreenError) else fault_of(error)
    if own is not None:
        return printable(f"error: {own}")
    # A defect of gyroscreen: the page has no place for a traceback, the log of the server has.
    _LOG.error("work of the interactive page failed", exc_info=error)
    return printable(f"{DEFECT}: {type(error).__name__}: {error}")
