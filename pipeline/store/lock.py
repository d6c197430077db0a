"""One writer per run: ``writer.lock`` names the process that works on a run.

The lock is that of the operating system (flock), so it ends with its process, even by kill -9: a file without a holder is
stale and is taken over.  On a network file system the lock holds across hosts where the file system passes locks on.
"""

from __future__ import annotations

import json
import os
import socket
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path

from ..errors import IncompleteError, UsageError

if sys.platform != "win32":
    import fcntl

NAME = "writer.lock"


@contextmanager
def one_writer(folder: Path) -> Iterator[None]:
    """Hold the lock of a run's folder.

    Raises
    ------
    UsageError : another process holds it.
    IncompleteError : the file system does not allow it.
    """
    if sys.platform == "win32":
        yield  # Without file locks the caller must ensure that each run has one writer.
        return
    path = folder / NAME
    handle = _acquired(path)
    try:
        yield
    finally:
        with suppress(OSError):
            path.unlink()
        os.close(handle)


def _acquired(path: Path) -> int:
    """Descriptor of the lock file, locked, with this process as its content."""
    while True:
        try:
            handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
        except OSError as error:
            raise _without_lock(path, error) from None
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(handle)
            raise UsageError(
                f"another process works on the run {path.parent.name.removeprefix('run=')}",
                value=_holder(path),
                allowed="one writer per run",
                next_step="wait for it, or end it and then resume the run",
            ) from None
        except OSError as error:  # a network file system that passes no locks on
            os.close(handle)
            raise _without_lock(path, error) from None
        # The former holder may have removed the file between the two calls; the lock would be on nothing.
        with suppress(OSError):
            if os.fstat(handle).st_ino == path.stat().st_ino:
                break
        os.close(handle)
    me = {"pid": os.getpid(), "host": socket.gethostname(), "since": datetime.now(UTC).isoformat(timespec="seconds")}
    try:
        with suppress(OSError):  # no space: the lock holds, only its holder is not named
            os.ftruncate(handle, 0)
            os.pwrite(handle, json.dumps(me).encode(), 0)
    except BaseException:  # an interrupt must not leave the run locked for the rest of this process
        os.close(handle)
        raise
    return handle


def _without_lock(path: Path, error: OSError) -> IncompleteError:
    return IncompleteError(
        f"the run cannot be locked ({error.strerror})",
        value=str(path),
        allowed="a folder that can be written, on a file system with locks (flock)",
        next_step="free disk space, fix permissions, or copy the run to a local disk; then gyroscreen run --resume",
    )


def _holder(path: Path) -> str:
    with suppress(OSError, ValueError, KeyError, TypeError):
        me = json.loads(path.read_bytes())
        return f"process {me['pid']} on {me['host']} since {me['since']}"
    return "unknown process"
