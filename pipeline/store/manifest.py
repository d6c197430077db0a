"""The manifest: the committed content of a run and the only list of its files.

    manifest.json = canonical JSON of the manifest, with ``sha256`` over the same JSON without that key

Canonical: sorted keys, fixed indentation, UTF-8.  A reader encodes the parsed manifest again and compares
all bytes, so every changed bit is detected, white space included.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

import msgspec

from ..errors import IntegrityError
from .files import sha256
from .log import LogState

FORMAT = 1
NAME = "manifest.json"

Status = Literal["running", "stopped", "complete"]
Kind = Literal["config", "devices", "posterior", "irregularities", "page"]


@dataclass(frozen=True)
class FileEntry:
    """One committed file; ``block`` and ``rows`` belong to tables.

    A table of several blocks has those from ``block`` to ``last``.
    ``next_sha256`` is set while a page is replaced: it may then have either content.
    """

    name: str
    kind: Kind
    bytes: int
    sha256: str
    block: int | None = None
    rows: int | None = None
    next_sha256: str | None = None
    last: int | None = None

    def span(self) -> range:
        """Numbers of the blocks of a table."""
        first = self.block or 0
        return range(first, (first if self.last is None else self.last) + 1)

    def to_dict(self) -> dict[str, Any]:
        """For JSON; ``last`` only where there is one, as files written before it existed have none."""
        return {name: value for name, value in asdict(self).items() if name != "last" or value is not None}


def in_block_order(files: Iterable[FileEntry]) -> tuple[FileEntry, ...]:
    """Files by block, the order in which tables are read; files without a block come first."""
    return tuple(sorted(files, key=lambda file: (-1 if file.block is None else file.block, file.name)))


@dataclass(frozen=True)
class Manifest:
    """Identity and files of a run.

    Parameters
    ----------
    run_id : name of the run; its folder is ``run=<run_id>``.
    status : "running" until finished; a killed run stays "running".
    created, finished : ISO 8601, UTC; ``finished`` is null while running.
    config_sha256 : SHA-256 of ``run.toml``.
    provenance : seed, versions, platform (see pipeline.store.provenance).
    files : committed files, in the order of their commits.
    summary : given by the caller when the run finished.
    devices_digest : digest of the values of the whole ``devices`` table, at the end.
    log : log.jsonl when this manifest was written.
    format : version of this layout.
    """

    run_id: str
    status: Status
    created: str
    finished: str | None
    config_sha256: str
    provenance: Mapping[str, Any]
    files: tuple[FileEntry, ...]
    summary: Mapping[str, Any] = field(default_factory=dict)
    devices_digest: str | None = None
    log: LogState | None = None
    format: int = FORMAT

    def of_kind(self, kind: Kind) -> tuple[FileEntry, ...]:
        """Files of one kind, by block."""
        return tuple(sorted((f for f in self.files if f.kind == kind), key=lambda f: (f.block or 0, f.name)))

    def blocks(self) -> frozenset[int]:
        """Numbers of the committed blocks."""
        return frozenset(n for f in self.files if f.kind == "devices" and f.block is not None for n in f.span())

    def rows(self, kind: Kind) -> int:
        """Number of rows of one table over all blocks."""
        return sum(f.rows or 0 for f in self.of_kind(kind))


def _canonical(content: Mapping[str, Any]) -> bytes:
    text = json.dumps(content, sort_keys=True, indent=1, ensure_ascii=False, allow_nan=False)
    return (text + "\n").encode()


def encode(manifest: Manifest) -> bytes:
    """Canonical bytes of a manifest, with their own hash.

    Raises
    ------
    TypeError, ValueError : provenance or summary hold values that JSON cannot represent, such as NaN.
    """
    content = {**asdict(manifest), "files": [entry.to_dict() for entry in manifest.files]}
    return _canonical({**content, "sha256": sha256(_canonical(content))})


def decode(data: bytes, where: str) -> Manifest:
    """Parse and check a manifest.

    Raises
    ------
    IntegrityError : the bytes differ from those that were written, or a newer version wrote them.
    """
    try:
        content = json.loads(data.decode())
        if not isinstance(content, dict):
            raise ValueError("no object")
        claimed = content.get("sha256")
        without = {key: value for key, value in content.items() if key != "sha256"}
        whole = _canonical(content) == data and claimed == sha256(_canonical(without))
    except (ValueError, RecursionError):  # UnicodeDecodeError and JSONDecodeError are ValueErrors
        whole = False
    if not whole:
        raise IntegrityError(
            f"{where} is damaged: its bytes do not match their own SHA-256",
            allowed="the manifest as the run wrote it",
            next_step="run `gyroscreen verify`; restore the run from a copy, or move it away",
        )
    if content.get("format") != FORMAT:
        raise IntegrityError(
            f"{where} has another format version",
            value=content.get("format"),
            allowed=str(FORMAT),
            next_step="read it with the gyroscreen version that wrote it (provenance, versions)",
        )
    try:
        return msgspec.convert(without, Manifest)
    except msgspec.ValidationError as error:
        raise IntegrityError(
            f"{where} lacks what a manifest holds ({error})", next_step="run `gyroscreen verify`"
        ) from None
