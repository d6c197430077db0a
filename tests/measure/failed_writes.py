"""Every operation on the disk fails in turn: ENOSPC, EIO, a short write, the end of the process before or after it.

usage: python -m tests.measure.failed_writes FOLDER [STRIDE]; FOLDER/cases.jsonl has a line a case, which is not repeated.

The run commits blocks out of order, merges them at checkpoints, amends devices, writes a page twice, and is closed.  After each
fault: nothing that was committed is lost, `verify` finds no damage, and the resumed run has the tables and files of an
undisturbed one, without strays.
"""

from __future__ import annotations

import json
import shutil
import sys
from contextlib import suppress
from pathlib import Path

import pytest

from pipeline.errors import IncompleteError
from pipeline.store import checkpoint, journal
from pipeline.store.read import read_run
from pipeline.store.run import RunStore, create_run
from pipeline.store.verify import verify
from tests.disk import KINDS, Disk, ProcessEnd, failing
from tests.pipeline.store.store_runs import CONFIG, PROVENANCE, block_tables

BLOCKS = (1, 0, 3, 2, 4)
AMENDED = {"000005": {"p_pass_with_effects": 0.25}}
Content = dict[str, str]


def _write(store: RunStore, done: set[int]) -> None:
    """All that a night does; ``done`` receives the blocks whose commit has returned."""
    if store.manifest.status != "complete":
        for block in BLOCKS:
            store.commit_block(block, *block_tables(block))
            done.add(block)
    store.amend_devices(AMENDED)
    for page in (b"first", b"second"):
        store.write_file("report.html", page)
    store.finish("complete", {})


def _content(store: RunStore) -> Content:
    """SHA-256 of the files of a run, and the digest of its devices."""
    manifest = read_run(store.folder.parent, store.run_id).manifest
    assert not verify(store.folder.parent).findings, verify(store.folder.parent).findings
    return {entry.name: entry.sha256 for entry in manifest.files} | {"digest": str(manifest.devices_digest)}


def _small(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(checkpoint, "BLOCKS", 2)
    patch.setattr(journal, "_LEAST_LINES", 2)


def undisturbed(folder: Path) -> Content:
    """Content of the run without faults."""
    with pytest.MonkeyPatch.context() as patch, failing(Disk(folder)):
        _small(patch)
        store = create_run(folder, "r", CONFIG, PROVENANCE)
        _write(store, set())
        return _content(store)


def operations(folder: Path) -> int:
    """Number of operations on the disk."""
    with pytest.MonkeyPatch.context() as patch:
        _small(patch)
        store = create_run(folder, "r", CONFIG, PROVENANCE)
        with failing(Disk(folder)) as disk:
            _write(store, set())
        return disk.count


def fault(folder: Path, kind: str, moment: int, expected: Content) -> str:
    """What is wrong after a fault of ``kind`` at the ``moment``-th operation; empty if nothing is."""
    with pytest.MonkeyPatch.context() as patch:
        _small(patch)
        store, done = create_run(folder, "r", CONFIG, PROVENANCE), set[int]()
        with failing(Disk(folder, kind, moment)), suppress(IncompleteError, ProcessEnd):
            _write(store, done)
        found = verify(folder)
        if not found.ok:
            return f"damage: {found.errors[0]}"
        lost = done - store.committed_blocks()
        if lost:
            return f"committed blocks lost: {sorted(lost)}"
        again = RunStore(store.folder)
        with failing(Disk(folder)):
            _write(again, set())
        now = _content(again)
    return "" if now == expected else f"another run: {sorted(set(now.items()) ^ set(expected.items()))[:4]}"


def main() -> None:
    """All cases that are not done."""
    folder, stride = Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 1
    shutil.rmtree(folder / "work", ignore_errors=True)
    (folder / "work").mkdir(parents=True)
    expected, count = undisturbed(folder / "work" / "undisturbed"), operations(folder / "work" / "counted")
    log = folder / "cases.jsonl"
    lines = [json.loads(line) for line in log.read_text().splitlines()] if log.exists() else []
    known = {(line["kind"], line["moment"]) for line in lines}
    for kind in KINDS:
        for moment in range(1, count + 1, stride):
            if (kind, moment) in known:
                continue
            case = folder / "work" / "case"
            lines.append({"kind": kind, "moment": moment, "wrong": fault(case, kind, moment, expected)})
            with log.open("a") as file:
                file.write(json.dumps(lines[-1]) + "\n")
            shutil.rmtree(case)
    wrong = [line for line in lines if line["wrong"]]
    print(f"{len(lines)} faults at {count} operations: {len(wrong)} wrong", *wrong[:10], sep="\n")


if __name__ == "__main__":
    main()
