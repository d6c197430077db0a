"""Atomic files: stage, fsync, rename, fsync the folder.

If a process dies or power fails at any moment, a file in a run's folder holds either its complete old
content or its complete new content.  Leftovers of an interrupted write end in ``.staged``.
"""

from __future__ import annotations

import hashlib
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

if sys.platform != "win32":
    import fcntl

STAGED = ".staged"


def sha256(data: bytes | memoryview) -> str:
    """SHA-256 in hex."""
    return hashlib.sha256(data).hexdigest()


def file_sha256(path: Path) -> tuple[str, int]:
    """SHA-256 in hex and size [bytes] of a file; ("", 0) if it cannot be read."""
    with suppress(OSError):
        if path.is_file():  # reading a pipe would wait forever
            with path.open("rb") as file:
                return hashlib.file_digest(file, "sha256").hexdigest(), file.tell()
    return "", 0


def stage(folder: Path, name: str, data: bytes | memoryview) -> Path:
    """Write bytes to ``.<name>.staged`` and fsync; readers ignore this name."""
    path = folder / f".{name}{STAGED}"
    handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | getattr(os, "O_BINARY", 0), 0o644)
    try:
        write_all(handle, data)
        os.fsync(handle)
    finally:
        os.close(handle)
    return path


def write_all(handle: int, data: bytes | memoryview) -> None:
    """Write all bytes; a short write is continued."""
    left = memoryview(data)
    while left:
        left = left[os.write(handle, left) :]


def publish(folder: Path, name: str) -> None:
    """Rename a staged file to its final name atomically; durable only after :func:`fsync_folder`."""
    (folder / f".{name}{STAGED}").replace(folder / name)


def fsync_folder(folder: Path) -> None:
    """Make renames in a folder survive a power failure."""
    if sys.platform == "win32":
        return  # Windows cannot open folders; NTFS journals the rename.
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


@contextmanager
def replacing(folder: Path, name: str) -> Iterator[BinaryIO]:
    """A file to write to, which replaces ``name`` atomically once it is complete; on failure the old file is unchanged."""
    staged = folder / f".{name}{STAGED}"
    try:
        with staged.open("wb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        publish(folder, name)
        fsync_folder(folder)
    finally:
        staged.unlink(missing_ok=True)


def replace_file(folder: Path, name: str, data: bytes | memoryview) -> None:
    """Replace a file atomically: on failure the old file is unchanged."""
    stage(folder, name, data)
    publish(folder, name)
    fsync_folder(folder)


def staged_files(folder: Path) -> tuple[Path, ...]:
    """Leftovers of interrupted writes."""
    return tuple(sorted(path for path in folder.iterdir() if path.name.startswith(".") and path.name.endswith(STAGED)))


@contextmanager
def writing(folder: Path, clean: bool = True) -> Iterator[None]:
    """Lock a run's folder for writing; a second writer waits.  The lock ends with its process, even by kill -9.

    Leftovers found under the lock have no owner; with ``clean`` they are removed, which reads the whole folder.
    """
    if sys.platform == "win32":
        yield  # Without file locks the caller must ensure that each run has one writer.
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX)
        if clean:
            for path in staged_files(folder):
                path.unlink()
        yield
    finally:
        os.close(handle)
