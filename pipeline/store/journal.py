"""The journal of commits since manifest.json was written: a commit costs the same at the first block and at the last.

    journal-<a>.jsonl, a = first 16 digits of SHA-256(manifest.json)
    line k = {"files": [..], "sha256": h_k},  h_k = SHA-256(h_(k-1) + files as JSON),  h_0 = SHA-256(manifest.json)

The name binds a journal to one manifest.json: a checkpoint writes manifest.json by rename, which makes the old journal stale
at the same moment.  A last line without its line feed is the torn tail of an interrupted write and was never committed.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import msgspec

from ..errors import IntegrityError
from .files import fsync_folder, sha256
from .log import last_block
from .manifest import NAME as MANIFEST
from .manifest import FileEntry, Manifest, Status, decode

#: Checkpoints: when the journal has this many lines, or an eighth of the files of the manifest, which a checkpoint writes anew.
_LEAST_LINES, _FILES_PER_LINE = 256, 8


def journal_name(manifest_sha256: str) -> str:
    """File name of the journal that follows the manifest.json with this SHA-256."""
    return f"journal-{manifest_sha256[:16]}.jsonl"


def read_lines(data: bytes, before: str, where: str) -> tuple[list[list[FileEntry]], str, int]:
    """The commits in ``data``, the hash of the last one, and the number of bytes without a torn tail.

    ``before`` is the hash before the first line.

    Raises
    ------
    IntegrityError : a line is not what was committed.
    """
    whole = data.rfind(b"\n") + 1
    commits, last = [], before
    for number, line in enumerate(data[:whole].splitlines(), 1):
        try:
            content = json.loads(line)
            entries = msgspec.convert(content["files"], list[FileEntry])
            found = content["sha256"]
        except (ValueError, KeyError, TypeError, RecursionError):  # JSON, Unicode and validation errors are ValueErrors
            entries, found = [], ""
        if found != _hash(last, entries) or line != _line(entries, found)[:-1]:
            raise IntegrityError(
                f"{where}, line {number}, is not what was committed",
                next_step="run `gyroscreen verify`; restore the run from a copy, or move it away",
            )
        commits.append(entries)
        last = found
    return commits, last, whole


def read_journal(folder: Path, manifest_sha256: str) -> list[FileEntry]:
    """Files committed since manifest.json; raises as :func:`read_lines`."""
    path = folder / journal_name(manifest_sha256)
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        return []
    commits, _, _ = read_lines(data, manifest_sha256, str(path))
    return [entry for commit in commits for entry in commit]


def read_manifest(folder: Path) -> Manifest:
    """Read and check the manifest of a run's folder, with what the journal has added to it.

    Raises
    ------
    IntegrityError : it is missing, unreadable or damaged, or belongs to another run.
    """
    path = folder / MANIFEST
    logged = last_block(folder)
    data = _bytes_of(path)
    while True:
        manifest = decode(data, str(path))
        added = read_journal(folder, sha256(data))
        # A checkpoint between the two files would hide the commits of the journal that it replaces.
        again = _bytes_of(path)
        if again == data:
            break
        data = again
    if folder.name != f"run={manifest.run_id}":
        raise IntegrityError(
            f"{path} belongs to another run",
            value=manifest.run_id,
            allowed=folder.name.removeprefix("run="),
            next_step=f"rename the folder to run={manifest.run_id}",
        )
    if added:
        files = (*manifest.files, *added)
        manifest = replace(manifest, files=files, status="running", finished=None, devices_digest=None)
    if logged is not None and manifest.status != "complete" and logged not in manifest.blocks():
        raise IntegrityError(
            f"{folder / journal_name(sha256(data))} lacks commits: the log of the run names block {logged}",
            allowed="every block whose commit was logged",
            next_step="`gyroscreen verify --repair`, then resume the run; or restore it from a copy",
        )
    return manifest


def _bytes_of(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise IntegrityError(
            f"{path} cannot be read ({error.strerror})",
            next_step="move the folder out of the results folder, or restore it from a copy",
        ) from None


def _hash(before: str, entries: Sequence[FileEntry]) -> str:
    return sha256((before + _json(entries)).encode())


def _json(entries: Sequence[FileEntry]) -> str:
    return json.dumps([entry.to_dict() for entry in entries], sort_keys=True, ensure_ascii=False)


def _line(entries: Sequence[FileEntry], digest: str) -> bytes:
    return f'{{"files": {_json(entries)}, "sha256": "{digest}"}}\n'.encode()


@dataclass
class Journal:
    """What a writer remembers of manifest and journal, so that a commit reads only what others have added.

    Only valid under the lock of the run's folder, after :meth:`refresh`.
    """

    status: Status = "running"
    blocks: set[int] = field(default_factory=set)
    lines: int = 0
    files: int = 0
    _of: tuple[int, int, int] | None = None
    _name: str = ""
    _last: str = ""
    _bytes: int = 0

    def refresh(self, folder: Path) -> None:
        """Take over what has been written since the last call; IntegrityError where it is damaged."""
        path = folder / MANIFEST
        found = path.stat()
        identity = (found.st_ino, found.st_mtime_ns, found.st_size)
        if identity != self._of:
            data = path.read_bytes()
            manifest = decode(data, str(path))
            self.status, self.blocks, self.files = manifest.status, set(manifest.blocks()), len(manifest.files)
            self._last, self._bytes, self.lines = sha256(data), 0, 0
            self._name = journal_name(self._last)
            self._of = identity
        path = folder / self._name
        if path.exists() and path.stat().st_size != self._bytes:
            with path.open("rb") as file:
                file.seek(self._bytes)
                commits, self._last, whole = read_lines(file.read(), self._last, str(path))
            self._bytes += whole
            for entries in commits:
                self._added(entries)

    def append(self, folder: Path, entries: Sequence[FileEntry]) -> None:
        """Commit ``entries``; OSError leaves the journal as it was."""
        path = folder / self._name
        digest = _hash(self._last, entries)
        line = _line(entries, digest)
        handle = os.open(path, os.O_WRONLY | os.O_CREAT, 0o644)
        try:
            os.ftruncate(handle, self._bytes)  # a torn tail
            try:
                _write(handle, line, self._bytes)
                os.fsync(handle)
            except OSError:
                os.ftruncate(handle, self._bytes)
                raise
        finally:
            os.close(handle)
        if self._bytes == 0:
            fsync_folder(folder)
        self._last, self._bytes = digest, self._bytes + len(line)
        self._added(entries)

    @property
    def long(self) -> bool:
        """Whether it is time for a checkpoint; the cost of checkpoints per commit is then constant."""
        return self.lines >= max(_LEAST_LINES, self.files // _FILES_PER_LINE)

    def _added(self, entries: Iterable[FileEntry]) -> None:
        self.status = "running"
        self.lines += 1
        self.blocks |= {entry.block for entry in entries if entry.kind == "devices" and entry.block is not None}


def _write(handle: int, line: bytes, at: int) -> None:
    """All of ``line`` at offset ``at``; a short write is continued."""
    done = 0
    while done < len(line):
        done += os.pwrite(handle, line[done:], at + done)
