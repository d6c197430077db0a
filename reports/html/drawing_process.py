"""A page draws its figures on two cores: some here, some in a second process.  matplotlib takes most of the time of a page.

    page     draws from the first figure on  -->                                <--  from the last one on     process

The process is started before the page reads its tables, because it takes a second to load matplotlib, and a thread waits for it.
A figure that it cannot draw, or that cannot be sent to it, is drawn here, so an error is that of a page without it.
"""

from __future__ import annotations

import gc
import os
import pickle
import subprocess
import sys
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib import import_module
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING

from markupsafe import Markup

from pipeline.threads import usable_cores

if TYPE_CHECKING:  # it loads matplotlib
    from .style import Drawing

#: What draws a figure; ``None`` where there is nothing to draw.  A ``partial`` of a function of a module can be sent.
Ask = Callable[[], "Drawing | None"]


class DrawingProcess:
    """A process that draws one figure after the other; ``module`` is what it loads before it is given the first."""

    def __init__(self, module: str) -> None:
        # -P: the working folder is not searched for imports.
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", __name__, module],
            env={**os.environ, "PYTHONPATH": os.pathsep.join(path or str(Path.cwd()) for path in sys.path)},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            start_new_session=True,  # Ctrl-C is for the page
        )
        self._thread = Thread()
        self._ready = False

    def take(self, waiting: deque[tuple[int, Ask]], found: dict[int, Markup | None]) -> None:
        """Draw figures from the end of ``waiting`` into ``found`` from now on; one that cannot be drawn goes back."""
        self._thread = Thread(target=self._take, args=(waiting, found))
        self._thread.start()

    def finish(self) -> None:
        """Wait until the figure that was taken is drawn or given back."""
        self._thread.join()

    def close(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.wait()
        if self._thread.ident is not None:
            self._thread.join()
        for pipe in (self._process.stdin, self._process.stdout):
            with suppress(OSError):  # what was written and not sent
                assert pipe is not None
                pipe.close()

    def _take(self, waiting: deque[tuple[int, Ask]], found: dict[int, Markup | None]) -> None:
        # Until it is there it takes nothing: a page of few figures does not wait for it.
        self._ready = self._ready or self._answer()[0]
        if not self._ready:
            return
        with suppress(IndexError):
            while True:
                number, ask = waiting.pop()
                done, text = self._drawn(ask)
                if not done:
                    waiting.append((number, ask))
                    return
                found[number] = None if text is None else Markup(text)

    def _drawn(self, ask: Ask) -> tuple[bool, str | None]:
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(pickle.dumps(ask))
            self._process.stdin.flush()
        except (OSError, pickle.PickleError, TypeError, AttributeError):
            return False, None
        return self._answer()

    def _answer(self) -> tuple[bool, str | None]:
        assert self._process.stdout is not None
        try:
            done, text = pickle.load(self._process.stdout)
        except (OSError, EOFError, pickle.PickleError):
            return False, None
        return done, text


@contextmanager
def drawing_beside(module: str) -> Iterator[DrawingProcess | None]:
    """A second process for figures of ``module``; ``None`` where there is no core for it."""
    if usable_cores() < 2:
        yield None
        return
    beside = DrawingProcess(module)
    try:
        yield beside
    finally:
        beside.close()


def drawn(asked: Sequence[Ask], beside: DrawingProcess | None = None) -> list[Markup | None]:
    """The figures, in the order in which they are asked for, as markup of a page."""
    waiting, found = deque(enumerate(asked)), dict[int, Markup | None]()
    if beside is not None:
        beside.take(waiting, found)
    with _without_collection():
        _draw_here(waiting, found)
        if beside is not None and len(found) < len(asked):
            beside.finish()
            _draw_here(waiting, found)
    return [found[number] for number in range(len(asked))]


@contextmanager
def _without_collection() -> Iterator[None]:
    """Without the search for cyclic garbage, which a figure is: three searches among the figures of a page take 0.4 s."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def _draw_here(waiting: deque[tuple[int, Ask]], found: dict[int, Markup | None]) -> None:
    with suppress(IndexError):
        while True:
            number, ask = waiting.popleft()
            found[number] = _markup(ask)


def _markup(ask: Ask) -> Markup | None:
    drawing = ask()
    return None if drawing is None else Markup(drawing)


def _serve(module: str) -> None:
    """The process: draw what is asked for, until the page is gone."""
    asked, answers = sys.stdin.buffer, sys.stdout.buffer
    sys.stdout = sys.stderr
    gc.disable()  # for one page
    import_module(module)
    pickle.dump((True, None), answers)
    answers.flush()
    while True:
        try:
            ask = pickle.load(asked)
        except EOFError:
            return
        try:
            figure = _markup(ask)
            answer = (True, None if figure is None else str(figure))
        except Exception:  # the page draws it again, and reports the error
            answer = (False, None)
        pickle.dump(answer, answers)
        answers.flush()


if __name__ == "__main__":
    _serve(sys.argv[1])
