"""Progress of a run on stderr: a bar on a terminal, a line every 10 s elsewhere."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Protocol

_EVERY_S = 10.0
_LOADING = "loading the numerical code"


class Shown(Protocol):
    """What shows the progress of a run."""

    def advance(self, devices: int) -> None:
        """So many devices have just finished."""

    def partly(self, devices: int) -> None:
        """So many devices are done in blocks that are not."""


class _Nothing:
    def advance(self, devices: int) -> None:
        return

    def partly(self, devices: int) -> None:
        return


@contextmanager
def progress(total: int, done: int, quiet: bool, doing: str = "identifying") -> Iterator[Shown]:
    """Show how many devices are done, the rate and the remaining time.

    ``total`` devices, ``done`` of them before the start; ``doing`` names the work.
    """
    if quiet:
        yield _Nothing()
    elif sys.stderr.isatty():
        with _bar(total, done, doing) as shown:
            yield shown
    else:
        yield _Lines(total, done, doing)


@contextmanager
def counted(total: int, quiet: bool, doing: str) -> Iterator[Callable[[], None]]:
    """Show how many of ``total`` steps are done, each of which calls what is yielded; off a terminal only what is done."""
    if quiet:
        yield lambda: None
    elif sys.stderr.isatty():
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
        with Progress(*columns, console=Console(stderr=True)) as bar:
            task = bar.add_task(doing, total=total)
            yield lambda: bar.advance(task)
    else:
        with suppress(OSError):
            print(doing, file=sys.stderr, flush=True)
        yield lambda: None


@contextmanager
def _bar(total: int, done: int, doing: str) -> Iterator[Shown]:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("devices  {task.fields[rate]}  left"),
        TimeRemainingColumn(),
    )
    started = time.monotonic()
    with Progress(*columns, console=Console(stderr=True)) as bar:
        # Workers first load the numerical code, or compile it.
        task = bar.add_task(_LOADING, total=total, completed=done, rate="")

        class Bar:
            count = shown = 0

            def advance(self, devices: int) -> None:
                self.count += devices
                self.partly(0)

            def partly(self, devices: int) -> None:
                # A block whose result is under way has no sign of life any more.
                now = self.shown = max(self.count + devices, self.shown)
                rate = now / max(time.monotonic() - started, 1e-9)
                bar.update(task, description=doing, completed=done + now, rate=f"{rate:.1f}/s")

        yield Bar()


class _Lines:
    """One line every 10 s, and one at the end."""

    def __init__(self, total: int, done: int, doing: str) -> None:
        self._total, self._done, self._fresh, self._doing = total, done, 0, doing
        self._started = self._last = time.monotonic()

    def advance(self, devices: int) -> None:
        self._fresh += devices
        self.partly(0)

    def partly(self, devices: int) -> None:
        now = time.monotonic()
        fresh = self._fresh + devices
        finished = self._done + fresh
        if now - self._last < _EVERY_S and (devices or finished < self._total):
            return
        self._last = now
        rate = fresh / max(now - self._started, 1e-9)
        text = f"{self._doing}: {finished} of {self._total} devices"
        if fresh:  # nothing is known of the time before
            text += f", {rate:.1f}/s, {(self._total - finished) / rate:.0f} s left"
        # A run must not stop because its stderr was closed.
        with suppress(OSError):
            print(text, file=sys.stderr, flush=True)
