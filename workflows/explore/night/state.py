"""What the panels of one page of a night share, and who is told when it changes.

A limit that moves is judged by the preview within the frame; when it has rested for ``_REST_MS`` the judgement itself starts in a
process of its own, and replaces the preview unless a limit has moved meanwhile, which ends it.

    event        told when
    verdicts     the verdicts are others: a preview, or the judgement
    judged       the judgement itself has come
    message      a limit was refused, or that has passed
    wafer        other devices are shown
    selection    other devices are selected
    device       another device is looked at
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor, Future
from functools import partial
from typing import Any, Literal, Protocol

import numpy as np
from bokeh.document import Document

from pipeline.arrays import IntArray
from pipeline.errors import GyroscreenError
from reports.limits import Limits

from ..worker import line_of
from .file import moved
from .judged import JudgedLimits, as_stored, judged_by, preview
from .preview import Kept
from .stored import NightData


class Judge(Protocol):
    """Where limits are judged: :class:`workflows.explore.process.StoppableProcess`."""

    def submit(self, function: Callable[..., Any], /, *arguments: Any) -> Future[Any]:
        """Do ``function``; its result or error goes to the future."""

    def stop(self, wanted: Future[Any]) -> None:
        """Give ``wanted`` up."""


Event = Literal["verdicts", "judged", "message", "wafer", "selection", "device"]
_REST_MS = 250


class NightState:
    """The state of one page; it belongs to its session alone, the run in it to all.

    Parameters
    ----------
    night : the run.
    document : of the session.
    worker : does what takes longer than a frame.
    judge : judges limits.
    """

    def __init__(self, night: NightData, document: Document, worker: Executor, judge: Judge) -> None:
        self.night, self.document, self.worker, self.judge = night, document, worker, judge
        self.limits: Limits = night.limits
        self.judged = as_stored(night)
        self.message = ""
        self.wafer = ""
        self.selected: IntArray = np.zeros(0, dtype=np.int64)
        self.device: int | None = None
        self._kept: Kept | None = None
        self._timer: Any = None
        self._judging: Future[JudgedLimits] | None = None
        self._quiet = False
        self._told: dict[Event, list[Callable[[], None]]] = {}
        document.on_session_destroyed(lambda _: self._stop())

    def follow(self, event: Event, action: Callable[[], None]) -> None:
        """Run ``action`` whenever ``event`` is told."""
        self._told.setdefault(event, []).append(action)

    def tell(self, *events: Event) -> None:
        """Tell all who follow the events."""
        for event in events:
            for action in self._told.get(event, ()):
                action()

    def then(self, action: Callable[[], None]) -> Callable[[str, Any, Any], None]:
        """``action`` as the answer to a change that the user makes; what :meth:`quietly` changes is no event."""

        def changed(attribute: str, old: Any, new: Any) -> None:
            if not self._quiet:
                action()

        return changed

    def quietly(self, action: Callable[[], None]) -> None:
        """Run ``action``, whose changes of widgets are no events."""
        before, self._quiet = self._quiet, True
        try:
            action()
        finally:
            self._quiet = before

    def take(self, quantity: str, low: float, high: float) -> None:
        """Judge by the limits with that of ``quantity`` at ``low`` and ``high``; a refused limit changes nothing."""
        try:
            limits = moved(self.limits, quantity, low, high)
            found = None if limits == self.limits else preview(self.night, limits, quantity, self._kept)
        except GyroscreenError as error:
            self._say(str(error))
            return
        self._say("")
        if found is None:
            return
        self._stop()
        self.limits = limits
        self.judged, self._kept = found
        self.tell("verdicts")
        self._timer = self.document.add_timeout_callback(self._rested, _REST_MS)

    def restore(self) -> None:
        """Back to the limits of the run."""
        self._stop()
        self.limits, self.judged, self._kept = self.night.limits, as_stored(self.night), None
        self._say("")
        self.tell("verdicts", "judged")

    def work(self, task: Callable[[], Any], done: Callable[[Any], None]) -> None:
        """Run ``task`` in the thread for work, then ``done`` with its result or its error."""
        self._then(self.worker.submit(task), done)

    def _then(self, future: Future[Any], done: Callable[[Any], None]) -> None:
        def ended(found: Future[Any]) -> None:
            if not found.cancelled():
                self.document.add_next_tick_callback(partial(done, found.exception() or found.result()))

        future.add_done_callback(ended)

    def _stop(self) -> None:
        """No judgement of limits that have moved on."""
        if self._timer is not None:
            self.document.remove_timeout_callback(self._timer)
            self._timer = None
        if self._judging is not None:
            self.judge.stop(self._judging)
            self._judging = None

    def _rested(self) -> None:
        self._timer = None
        limits, night = self.limits, self.night
        if limits == night.limits:
            self._show(as_stored(night))
            return
        asked = self._judging = self.judge.submit(judged_by, night.results, night.run_id, limits)

        def answered(found: JudgedLimits | Exception) -> None:
            if self._judging is not asked:
                return
            self._judging = None
            if isinstance(found, Exception):
                self._say(line_of(found))
            else:
                self._show(found)

        self._then(asked, answered)

    def _show(self, found: JudgedLimits) -> None:
        self.judged = found
        self.tell("verdicts", "judged")

    def _say(self, message: str) -> None:
        if message != self.message:
            self.message = message
            self.tell("message")
