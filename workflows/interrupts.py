"""Ctrl-C: it always ends the command, and the command alone reports it.

A terminal sends SIGINT to all processes of a command.  The workers must not act on it: the command stops them.  And an
interrupt that falls into a callback from compiled code (numba) is printed and dropped by Python; it has to be repeated.
"""

from __future__ import annotations

import _thread
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker
from typing import Any

INTERRUPTED = 130
_SOON_S = 0.05


@contextmanager
def deaf_children() -> Iterator[None]:
    """Threads and processes that are started inside do not receive SIGINT, nor do those that they start.

    The signal mask is inherited; an interrupt that arrives inside is delivered to the caller at the end.
    """
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    # The tracker of multiprocessing clears the mask of the thread that starts it.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def repeat_lost_interrupts() -> None:
    """Interrupt the main thread again where Python could only print the interrupt."""
    usual = sys.unraisablehook

    def hook(lost: Any) -> None:
        if not issubclass(lost.exc_type, KeyboardInterrupt):
            usual(lost)
            return
        again = threading.Timer(_SOON_S, _interrupt_main)
        again.daemon = True
        again.start()

    sys.unraisablehook = hook


def _interrupt_main() -> None:
    if hasattr(signal, "pthread_kill"):  # wakes a thread that waits, too
        signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)
    else:
        _thread.interrupt_main()
