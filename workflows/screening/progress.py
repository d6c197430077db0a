"""Progress of a run on stderr: a bar on a terminal, a line every 10 s elsewhere."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

_EVERY_S = 10.0


@contextmanager
def progress(total: int, done: int, quiet: bool, doing: str = "identifying") -> Iterator[Callable[[int], None]]:
    """A function to call with the number of devices that have just finished; shows the rate and the remaining time.

    ``total`` devices, ``done`` of them before the start; ``doing`` names the work.
    """
    if quiet:
        yield lambda _: None
    elif sys.stderr.isatty():
        with _bar(total, done, doing) as advance:
            yield advance
    else:
        yield _Lines(total, done, doing).advance


@contextmanager
def _bar(total: int, done: int, doing: str) -> Iterator[Callable[[int], None]]:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (
        TextColumn(doing),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("devices  {task.fields[rate]}  left"),
        TimeRemainingColumn(),
    )
    started = time.monotonic()
    count = 0
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task("devices", total=total, completed=done, rate="")

        def advance(devices: int) -> None:
            nonlocal count
            count += devices
            rate = count / max(time.monotonic() - started, 1e-9)
            bar.update(task, advance=devices, rate=f"{rate:.1f}/s")

        yield advance


class _Lines:
    """One line every 10 s, and one at the end."""

    def __init__(self, total: int, done: int, doing: str) -> None:
        self._total, self._done, self._fresh, self._doing = total, done, 0, doing
        self._started = self._last = time.monotonic()

    def advance(self, devices: int) -> None:
        self._fresh += devices
        now = time.monotonic()
        finished = self._done + self._fresh
        if now - self._last < _EVERY_S and finished < self._total:
            return
        self._last = now
        rate = self._fresh / max(now - self._started, 1e-9)
        left = (self._total - finished) / max(rate, 1e-9)
        text = f"{self._doing}: {finished} of {self._total} devices, {rate:.1f}/s, {left:.0f} s left"
        # A run must not stop because its stderr was closed.
        with suppress(OSError):
            print(text, file=sys.stderr, flush=True)
