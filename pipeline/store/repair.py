"""Repairs that need only what a run still holds: lines of the log and of the journal, and files whose content is known.

A damaged file is first copied to the folder ``damaged`` of the run; nothing is deleted without trace.
"""

from __future__ import annotations

import shutil
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

from ..errors import IntegrityError
from . import files, log
from .checkpoint import put_manifest
from .journal import journal_name, read_lines, read_manifest
from .manifest import NAME as MANIFEST
from .manifest import FileEntry, decode
from .verify import ASIDE


def put_aside(folder: Path, name: str) -> None:
    """Copy a damaged file, if there is one, to the folder of damaged files, under a name that tells the time."""
    path, aside = folder / name, folder / ASIDE
    if path.is_file():
        aside.mkdir(exist_ok=True)
        shutil.copy2(path, aside / f"{name}.{datetime.now(UTC):%Y%m%dT%H%M%S%f}")


def restore_file(folder: Path, entry: FileEntry, data: bytes | memoryview) -> bool:
    """Replace a damaged file by ``data`` if that is what was committed; returns whether it is."""
    if files.sha256(data) != entry.sha256:
        return False
    with files.writing(folder):
        put_aside(folder, entry.name)
        files.replace_file(folder, entry.name, data)
    return True


def cut_journal(folder: Path) -> str:
    """Keep the commits of the journal up to the first line that is damaged; returns what was done.

    Raises
    ------
    IntegrityError : manifest.json is damaged, too.
    """
    data = (folder / MANIFEST).read_bytes()
    decode(data, str(folder / MANIFEST))
    before = files.sha256(data)
    name = journal_name(before)
    path = folder / name
    whole = path.read_bytes() if path.exists() else b""
    lines = whole.splitlines(keepends=True)
    low, high = 0, len(lines)
    while low < high:  # the first ``low`` lines are sound
        middle = (low + high + 1) // 2
        try:
            _, _, kept = read_lines(b"".join(lines[:middle]), before, name)
        except IntegrityError:
            high = middle - 1
        else:
            if kept < len(b"".join(lines[:middle])):
                high = middle - 1
            else:
                low = middle
    with files.writing(folder):
        put_aside(folder, name)
        if path.exists():
            files.replace_file(folder, name, b"".join(lines[:low]))
        log.append(folder, {"event": "journal cut", "lines": low, "of": len(lines)})
    return (
        f"{low} of {len(lines)} lines are sound and kept; `gyroscreen run --resume` computes the blocks of the others"
    )


def restore_log(folder: Path) -> str:
    """Keep the sound lines of the log; returns what was done."""
    path = folder / log.NAME
    lines = path.read_bytes().splitlines() if path.exists() else []
    kept = [line + b"\n" for line in lines if log.sound(line)]
    with files.writing(folder):
        put_aside(folder, log.NAME)
        files.replace_file(folder, log.NAME, b"".join(kept))
        log.append(folder, {"event": "log repaired", "lines": len(kept), "of": len(lines)})
        put_manifest(folder, replace(read_manifest(folder), log=None))
    return f"{len(kept)} of {len(lines)} lines are sound and kept"
