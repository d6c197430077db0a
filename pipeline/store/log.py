"""log.jsonl, the events of a run: each line carries its own hash, and the manifest that of all lines before it was written.

    line = {"time": .., "event": .., .., "sha256": h},  h = first 16 digits of SHA-256(line without its sha256)

Several processes may append lines, so lines are not chained.  A commit is logged after it is durable: a log that knows of a block
that neither manifest nor journal list shows that commits were lost.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import msgspec

from .files import sha256

NAME = "log.jsonl"
_KEY = b',"sha256":"'
_DIGITS = 16
#: Bytes at the end of a log in which the last commit is looked for.
_TAIL = 1 << 16


@dataclass(frozen=True)
class LogState:
    """Size and SHA-256 of a log when the manifest was written; later lines follow."""

    bytes: int
    sha256: str


def append(folder: Path, event: Mapping[str, Any]) -> None:
    """Append one line; NaN becomes null, other values that JSON lacks become text."""
    now = datetime.now(UTC).isoformat(timespec="milliseconds")
    plain = msgspec.json.encode({"time": now, **event}, enc_hook=str)
    # A single write in append mode keeps the lines of several processes apart.
    with (folder / NAME).open("ab", buffering=0) as file:
        file.write(plain[:-1] + _KEY + sha256(plain)[:_DIGITS].encode() + b'"}\n')


def state(folder: Path) -> LogState | None:
    """The log as it is now, ``None`` if there is none."""
    try:
        data = (folder / NAME).read_bytes()
    except OSError:
        return None
    return LogState(len(data), sha256(data))


def sound(line: bytes) -> bool:
    """Whether a line, without its line feed, is what was appended."""
    plain, key, rest = line.rpartition(_KEY)
    return bool(key) and rest == sha256(plain + b"}")[:_DIGITS].encode() + b'"}'


def damages(folder: Path, known: LogState | None) -> Iterator[str]:
    """What is not as it was written; lines of versions that did not hash them count as sound if ``known`` covers them."""
    try:
        data = (folder / NAME).read_bytes()
    except FileNotFoundError:
        if known is not None:
            yield "missing"
        return
    except OSError as error:
        yield f"cannot be read ({error.strerror})"
        return
    covered = 0 if known is None else known.bytes
    if known is not None and sha256(data[:covered]) == known.sha256:
        rest, first = data[covered:], data[:covered].count(b"\n") + 1
    else:
        rest, first = data, 1
        if known is not None:
            yield f"the first {covered} bytes have changed"
    hashed = known is not None or any(map(sound, data.splitlines()))
    # A last line without its line feed was never written completely.
    for number, line in enumerate(rest[: rest.rfind(b"\n") + 1].split(b"\n")[:-1], first):
        if hashed and not sound(line):
            yield f"line {number} has changed"


def last_block(folder: Path) -> int | None:
    """The block whose commit was logged last, ``None`` where the end of the log does not tell."""
    try:
        with (folder / NAME).open("rb") as file:
            size = file.seek(0, os.SEEK_END)
            file.seek(max(size - _TAIL, 0))
            lines = file.read().split(b"\n")
    except OSError:
        return None
    for line in reversed(lines):
        if b'"event":"journal cut"' in line and sound(line):
            return None
        if b'"event":"block"' in line and sound(line):
            block = msgspec.json.decode(line)["block"]
            return block if isinstance(block, int) else None
    return None
