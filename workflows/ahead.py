"""Loops of a search for effects are made ready on a second core, while a command reads and fits.

Where they are cached, a thread loads them.  Otherwise a second process compiles them (``python -m workflows.ahead``), because
compilation holds a lock of its process; the command takes from the cache what is ready when it needs it, and compiles the rest
itself.
"""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pipeline.experiment.forward.ahead import compile_loops, is_compiled, needed_loops
from pipeline.threads import usable_cores

from .process import deaf_children


@contextmanager
def compiled_ahead() -> Iterator[None]:
    """Load or compile the loops of a search for effects beside the block, if a second core is there."""
    if usable_cores() < 2:
        yield
        return
    if is_compiled():
        with _loaded_beside():
            yield
        return
    with deaf_children():
        process = subprocess.Popen(
            # -P: the working folder is not searched for imports.
            [sys.executable, "-P", "-m", __name__],
            env={**os.environ, "PYTHONPATH": os.pathsep.join(path or str(Path.cwd()) for path in sys.path)},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
    try:
        yield
    finally:
        process.kill()
        process.wait()


@contextmanager
def _loaded_beside() -> Iterator[None]:
    """Load the loops in a thread beside the block; one that is being loaded when the block ends is the last."""
    ended = threading.Event()

    def load() -> None:
        for make in needed_loops():
            if ended.is_set():
                return
            make()

    thread = threading.Thread(target=load)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


if __name__ == "__main__":
    compile_loops()
