"""Checkpoints: manifest.json takes over the journal, small block files become larger ones, and superseded files go.

    merged file: stage, fsync, rename -> manifest.json by rename -> remove the files that it no longer lists

The rename of manifest.json is the moment of change.  A process that dies before leaves a merged file that no manifest lists, one
that dies after leaves block files that no manifest lists any more; the next checkpoint removes both, readers ignore them.

Blocks are merged in aligned groups of ``BLOCKS`` once all of a group are committed, so the files of a run do not depend on the
order of its commits or on interruptions.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import pyarrow as pa

from ..errors import IntegrityError, UsageError
from . import files, log
from .block import block_file
from .journal import journal_name, read_manifest
from .manifest import NAME as MANIFEST
from .manifest import FileEntry, Kind, Manifest, encode
from .parquet import encode_table
from .read import read_block

#: Blocks of a merged file, and the size at which it is cut: a merge and a reader hold one such file in memory.
BLOCKS, MOST_BYTES = 256, 16 << 20
#: Rows of irregularities repeat their names and shrink to 3 bytes: a file of 16 MiB would take 0.8 GB in memory.
_MOST_BYTES_OF_NUMBERS = 2 << 20
#: At the end of a run the blocks after the last whole group are merged if there are at least so many: fewer are no burden.
_LEAST_REST = 32
#: Names of tables and journals, which only the store writes.
OWN = re.compile(r"(devices|posterior|irregularities)-\d{5,}(-\d{5,})?(-amended)?\.parquet|journal-[0-9a-f]{16}\.jsonl")


def put_manifest(folder: Path, manifest: Manifest) -> None:
    """Write manifest.json by rename; the journal before it is then stale, and removed.

    Raises
    ------
    UsageError : provenance or summary are not JSON.
    """
    before = journal_name(files.sha256((folder / MANIFEST).read_bytes()))
    if not any(log.damages(folder, manifest.log)):  # the hash of a damaged log would hide the damage
        manifest = replace(manifest, log=log.state(folder))
    data = encoded(manifest)
    files.replace_file(folder, MANIFEST, data)
    if before != journal_name(files.sha256(data)):
        (folder / before).unlink(missing_ok=True)


def encoded(manifest: Manifest) -> bytes:
    """The bytes of a manifest; UsageError where provenance or summary are not JSON."""
    try:
        return encode(manifest)
    except (TypeError, ValueError) as error:
        raise UsageError(
            f"provenance or summary of run {manifest.run_id} is not JSON ({error})",
            allowed="strings, finite numbers, lists and tables of these",
        ) from None


def checkpoint(folder: Path, manifest: Manifest, rest: bool = False) -> Manifest:
    """Write ``manifest`` with its small block files merged, and remove what it no longer lists; returns the new manifest.

    ``rest``: no further blocks will come, so the last group may be incomplete.  Only under the lock of the folder.

    Raises
    ------
    OSError : writing failed; the run is unchanged.
    """
    merged: list[FileEntry] = []
    replaced: set[str] = set()
    for group in groups(manifest, rest):
        # A damaged table must not end the night: it stays as it is, and `verify` names it.
        with suppress(IntegrityError):
            merged.append(_merge(folder, group))
            replaced |= {entry.name for entry in group}
    if merged:
        files.fsync_folder(folder)
    kept = tuple(entry for entry in manifest.files if entry.name not in replaced)
    now = replace(manifest, files=(*kept, *merged))
    put_manifest(folder, now)
    sweep(folder)
    return now


def sweep(folder: Path) -> None:
    """Remove staged files, tables and journals that the run does not list.  Only under the lock of the folder.

    What cannot be removed is left for the next time: it is no part of the run.
    """
    with suppress(OSError, IntegrityError):
        listed = {entry.name for entry in read_manifest(folder).files}
        listed.add(journal_name(files.sha256((folder / MANIFEST).read_bytes())))
        for path in list(folder.iterdir()):
            if path.name not in listed and (path.name.endswith(files.STAGED) or OWN.fullmatch(path.name)):
                path.unlink(missing_ok=True)


def groups(manifest: Manifest, rest: bool) -> list[tuple[FileEntry, ...]]:
    """Files of single blocks that become one file each, in block order."""
    blocks = manifest.blocks()
    found: list[tuple[FileEntry, ...]] = []
    kinds: tuple[Kind, ...] = ("devices", "posterior", "irregularities")
    for kind in kinds:
        own: dict[int, list[FileEntry]] = {}
        for entry in manifest.of_kind(kind):
            if entry.block is not None and entry.last is None:
                own.setdefault(entry.block // BLOCKS, []).append(entry)
        for number, entries in own.items():
            whole = blocks.issuperset(range(number * BLOCKS, (number + 1) * BLOCKS))
            if whole or (rest and len(entries) >= _LEAST_REST):
                found += _cut(entries, _MOST_BYTES_OF_NUMBERS if kind == "irregularities" else MOST_BYTES)
    return found


def _cut(entries: Sequence[FileEntry], most: int) -> list[tuple[FileEntry, ...]]:
    """Consecutive entries of at most ``most`` bytes together; a single one stays as it is."""
    parts: list[list[FileEntry]] = [[]]
    for entry in entries:
        if parts[-1] and sum(one.bytes for one in parts[-1]) + entry.bytes > most:
            parts.append([])
        parts[-1].append(entry)
    return [tuple(part) for part in parts if len(part) > 1]


def _merge(folder: Path, group: Sequence[FileEntry]) -> FileEntry:
    """One file with the rows of all ``group``, published but not yet in the manifest."""
    table = pa.concat_tables([read_block(folder, entry) for entry in group])
    first, last = group[0].block or 0, group[-1].block or 0
    data = memoryview(encode_table(table))
    name = block_file(group[0].kind, first, last)
    files.stage(folder, name, data)
    files.publish(folder, name)
    return FileEntry(name, group[0].kind, data.nbytes, files.sha256(data), block=first, last=last, rows=table.num_rows)
