"""A second process compiles loops while a command reads and fits: ``python -m workflows.ahead``.

Compilation holds a lock of its process, so threads do not help.  The command takes from the cache what is ready when it needs
it, and compiles the rest itself.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pipeline.experiment.forward.ahead import compile_loops, is_compiled
from pipeline.threads import usable_cores

from .process import deaf_children


@contextmanager
def compiled_ahead() -> Iterator[None]:
    """Compile the loops of a search for effects beside the block, if they are not cached and a second core is there."""
    if is_compiled() or usable_cores() < 2:
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


if __name__ == "__main__":
    compile_loops()
