"""Progress of compare, diagnose, refine and demo on stderr: a live line on a terminal, a line every 10 s elsewhere, as for a run.

The number of fits is not known beforehand, so the line says what is done at the moment and for how long: the problems and the
selection log it (``logging.getLogger("pipeline...")``, level INFO), and nobody else listens.
"""

from __future__ import annotations

import logging
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

#: Seconds between lines where stderr is no terminal; that of a run.
_EVERY_S = 10.0


@contextmanager
def working(doing: str, quiet: bool) -> Iterator[None]:
    """Show what the loop logs while the block runs; ``doing`` names the command."""
    if quiet:
        yield
        return
    with _live(doing) if sys.stderr.isatty() else _lines(doing) as show, heard(show):
        yield


@contextmanager
def heard(show: Callable[[str], None]) -> Iterator[None]:
    """Call ``show`` with what the loop logs while the block runs."""
    logger = logging.getLogger("pipeline")
    before = logger.level
    handler = _Handler(show)
    logger.addHandler(handler)
    logger.setLevel(logging.INFO)
    try:
        yield
    finally:
        logger.setLevel(before)
        logger.removeHandler(handler)


class _Handler(logging.Handler):
    """Passes the text of each record on."""

    def __init__(self, show: Callable[[str], None]) -> None:
        super().__init__(logging.INFO)
        self._show = show

    def emit(self, record: logging.LogRecord) -> None:
        """Show one record; a closed stderr must not stop the work."""
        with suppress(OSError, ValueError):
            self._show(record.getMessage())


@contextmanager
def _live(doing: str) -> Iterator[Callable[[str], None]]:
    from rich.console import Console
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = (SpinnerColumn(), TextColumn(doing), TimeElapsedColumn(), TextColumn("{task.description}", markup=False))
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("", total=None)
        yield lambda text: bar.update(task, description=text)


@contextmanager
def _lines(doing: str) -> Iterator[Callable[[str], None]]:
    started = last = time.monotonic()

    def show(text: str) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last >= _EVERY_S:
            last = now
            print(f"{doing}: {now - started:.0f} s, {text}", file=sys.stderr, flush=True)

    yield show
