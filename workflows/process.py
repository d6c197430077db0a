"""The process of a command: its workers, its memory, Ctrl-C, and text that its terminal can show.

A terminal sends SIGINT to all processes of a command.  The workers must not act on it: the command stops them and alone reports
it.  An interrupt that falls into a callback from compiled code (numba) is printed and dropped by Python; it has to be repeated.
Terminals that cannot show every character: cp1252, ASCII, or a pipe under LANG=C.
"""

from __future__ import annotations

import _thread
import codecs
import ctypes
import io
import signal
import sys
import threading
import unicodedata
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker
from typing import Any

from pipeline.errors import UsageError
from pipeline.threads import usable_cores

#: mallopt parameters of glibc (malloc.h): trim and mmap thresholds, padding of the heap [bytes], number of arenas.
_MALLOPT = {-1: 1 << 30, -3: 1 << 30, -2: 1 << 26, -8: 1}
INTERRUPTED = 130
_SOON_S = 0.05
_HANDLER = "gyroscreen"
#: Letters have their names (sigma); these signs have none that reads well.
_SIGNS = {
    "\u00b1": "+-", "\u2212": "-", "\u2013": "-", "\u2026": "...", "\u00b7": "*", "\u2264": "<=", "\u2265": ">=",
    "\u221a": "sqrt", "\u00b0": " deg", "\u2032": "'", "\u2033": "''", "\u201c": '"', "\u201d": '"', "\u00bd": "1/2",
    "\u2501": "-", "\u2588": "#",
}  # fmt: skip


def worker_count(wanted: int) -> int:
    """``wanted`` workers, or one per usable core if it is 0; UsageError if it is negative."""
    if wanted < 0:
        raise UsageError("invalid number of workers", value=wanted, allowed="1 or more, or 0 for one per core")
    return wanted or usable_cores()


def keep_memory() -> None:
    """Keep freed memory in the process: returning pages to the system and requesting them again costs 10 % of the time.

    Changes settings of the whole process; does nothing if the C library is not glibc.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError, TypeError):
        return
    for parameter, value in _MALLOPT.items():
        mallopt(parameter, value)


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


def end_like_ctrl_c() -> None:
    """SIGTERM and SIGHUP interrupt the command like Ctrl-C, so that it says how to go on; under nohup they stay ignored.

    Changes the handlers of the process.
    """
    for number in (getattr(signal, name, None) for name in ("SIGTERM", "SIGHUP")):
        if number is not None and signal.getsignal(number) is signal.SIG_DFL:
            signal.signal(number, signal.default_int_handler)


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


def survive_any_encoding() -> None:
    """Write characters that stdout or stderr cannot encode in ASCII instead of failing."""
    codecs.register_error(_HANDLER, _replaced)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors=_HANDLER)


def plain_text(text: str) -> str:
    """``text`` in ASCII: sigma, +-, ^-9; "?" where nothing reads well."""
    return "".join(one if one.isascii() else _spelled(one) for one in text)


def _replaced(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return plain_text(error.object[error.start : error.end]), error.end


def _spelled(one: str) -> str:
    name = unicodedata.name(one, "")
    if one in _SIGNS:
        return _SIGNS[one]
    if name.startswith("GREEK"):
        word = name.split("LETTER ")[-1].split(" WITH")[0]
        return word.lower() if "SMALL" in name else word.capitalize()
    # A superscript minus decomposes to a minus that is not ASCII; an accent alone is dropped.
    parts = (_SIGNS.get(part, part if part.isascii() else "") for part in unicodedata.normalize("NFKD", one))
    return "".join(parts) or ("" if unicodedata.combining(one) else "?")
