"""Files that are whole or not there: stage, fsync, rename, fsync the folder.

A process may die at any instruction and power may fail at any moment: a name in a run's folder either
holds the complete old bytes or the complete new ones.  Leftovers of an interrupted write end in
``.staged`` and belong to nobody.
"""

from __future__ import annotations

import hashlib
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

if sys.platform != "win32":
    import fcntl

STAGED = ".staged"


def sha256(data: bytes | memoryview) -> str:
    """SHA-256 in hex."""
    return hashlib.sha256(data).hexdigest()


def stage(folder: Path, name: str, data: bytes | memoryview) -> Path:
    """Write bytes to ``.<name>.staged`` and fsync; nobody reads them under that name."""
    path = folder / f".{name}{STAGED}"
    with path.open("wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())
    return path


def publish(folder: Path, name: str) -> None:
    """Give a staged file its name in one step; lasting only after :func:`fsync_folder`."""
    (folder / f".{name}{STAGED}").replace(folder / name)


def fsync_folder(folder: Path) -> None:
    """Make renames in a folder survive a power failure."""
    if sys.platform == "win32":
        return  # folders cannot be opened there; NTFS journals the rename
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def replace_file(folder: Path, name: str, data: bytes | memoryview) -> None:
    """Put a whole file in place of an old one, or leave the old one as it was."""
    stage(folder, name, data)
    publish(folder, name)
    fsync_folder(folder)


def staged_files(folder: Path) -> tuple[Path, ...]:
    """Leftovers of interrupted writes."""
    return tuple(sorted(path for path in folder.iterdir() if path.name.startswith(".") and path.name.endswith(STAGED)))


@contextmanager
def writing(folder: Path) -> Iterator[None]:
    """Hold a run's folder for writing; a second writer waits.  The lock dies with its process, even by
    kill -9.

    Leftovers found under the lock have no living owner and are removed.
    """
    if sys.platform == "win32":
        yield  # one writer a run is then the caller's promise
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX)
        for path in staged_files(folder):
            path.unlink()
        yield
    finally:
        os.close(handle)
