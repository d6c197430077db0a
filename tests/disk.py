"""A disk that fails on demand: an error, a short write or the end of the process at the n-th operation below a folder."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

#: errno of the kinds that are errors; "full" lasts, and half of the bytes are written before it.
ERRORS = {"full": 28, "EIO": 5}
KINDS = (*ERRORS, "short", "kill before", "kill after")


class ProcessEnd(BaseException):
    """The process ends here."""


class Disk:
    """Counts operations below ``folder`` and lets the ``moment``-th (from 1) go wrong as ``kind`` says."""

    def __init__(self, folder: Path, kind: str = "", moment: int = 0) -> None:
        self.folder, self.kind, self.moment, self.count = str(folder.resolve()), kind, moment, 0

    def wrapped(self, name: str, original: Callable[..., Any]) -> Callable[..., Any]:
        def operation(target: Any, *arguments: Any, **named: Any) -> Any:
            if not self._mine(target):
                return original(target, *arguments, **named)
            self.count += 1
            writes = name in ("write", "pwrite")
            if self.kind == "full" and self.count >= self.moment and (writes or name == "fsync"):
                if writes and self.count == self.moment and len(arguments[0]) > 1:
                    return original(target, arguments[0][: len(arguments[0]) // 2], *arguments[1:])
                raise OSError(ERRORS["full"], "No space left on device")
            if self.count != self.moment:
                return original(target, *arguments, **named)
            if self.kind == "EIO":
                raise OSError(ERRORS["EIO"], "Input/output error")
            if self.kind == "kill before":
                raise ProcessEnd
            if writes and self.kind in ("short", "kill after") and len(arguments[0]) > 1:
                done = original(target, arguments[0][: len(arguments[0]) // 2], *arguments[1:])
            else:
                done = original(target, *arguments, **named)
            if self.kind == "kill after":
                raise ProcessEnd
            return done

        return operation

    def _mine(self, target: Any) -> bool:
        path = Path(f"/proc/self/fd/{target}").readlink() if isinstance(target, int) else os.fspath(target)
        return str(path).startswith(self.folder)


@contextmanager
def failing(disk: Disk) -> Iterator[Disk]:
    """Operations of this process go through ``disk``; fsync of the others does not wait for the real disk."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda handle: None)
        for name in ("write", "pwrite", "fsync", "ftruncate", "replace", "unlink"):
            patch.setattr(os, name, disk.wrapped(name, getattr(os, name)))
        yield disk
