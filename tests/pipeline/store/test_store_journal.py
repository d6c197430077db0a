"""Commits go to a journal: constant cost, a torn tail is no commit, a changed line is damage, checkpoints change nothing."""

from __future__ import annotations

import itertools
from pathlib import Path

import pytest
from store_runs import CONFIG, PROVENANCE, ROWS, block_tables

from pipeline.errors import IncompleteError, IntegrityError
from pipeline.store import files, journal
from pipeline.store.read import read_run
from pipeline.store.run import RunStore, create_run, open_run
from pipeline.store.verify import verify


def begun(results: Path, blocks: int) -> RunStore:
    store = create_run(results, "r", CONFIG, PROVENANCE)
    for block in range(blocks):
        store.commit_block(block, *block_tables(block))
    return store


def journal_of(store: RunStore) -> Path:
    (path,) = store.folder.glob("journal-*.jsonl")
    return path


def test_a_commit_appends_one_line_and_leaves_the_manifest(tmp_path: Path) -> None:
    store = begun(tmp_path, 3)
    manifest, sizes = (store.folder / "manifest.json").read_bytes(), [journal_of(store).stat().st_size]
    for block in range(3, 9):
        store.commit_block(block, *block_tables(block))
        sizes.append(journal_of(store).stat().st_size)
    assert (store.folder / "manifest.json").read_bytes() == manifest
    assert len({later - sooner for sooner, later in itertools.pairwise(sizes)}) <= 3  # the digits of file sizes
    assert open_run(tmp_path).committed_blocks() == frozenset(range(9))
    assert not verify(tmp_path).findings
    store.finish("complete", {})
    assert not list(store.folder.glob("journal-*"))
    assert read_run(tmp_path).devices.num_rows == 9 * ROWS


def test_every_torn_tail_is_no_commit_and_the_next_commit_replaces_it(tmp_path: Path) -> None:
    store = begun(tmp_path, 3)
    path = journal_of(store)
    whole = path.read_bytes()
    start = whole[:-1].rfind(b"\n") + 1
    for cut in range(start, len(whole), 37):
        path.write_bytes(whole[:cut])
        assert open_run(tmp_path).committed_blocks() == {0, 1}
    path.write_bytes(whole[:start] + b"\0" * 40)  # as a power failure may leave it
    again = open_run(tmp_path)
    again.commit_block(2, *block_tables(2))
    assert path.read_bytes() == whole
    assert store.committed_blocks() == {0, 1, 2}


def test_every_changed_byte_of_the_journal_is_damage_or_a_torn_tail(tmp_path: Path) -> None:
    store = begun(tmp_path, 3)
    path = journal_of(store)
    whole = path.read_bytes()
    for at in range(0, len(whole), 11):
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :])
        if at < whole.rfind(b"\n"):
            with pytest.raises(IntegrityError, match="journal"):
                open_run(tmp_path)
    path.write_bytes(whole[len(whole) // 3 :])
    with pytest.raises(IntegrityError, match="journal"):
        open_run(tmp_path)


def test_two_writers_and_a_checkpoint_lose_no_block(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(journal, "_LEAST_LINES", 4)
    first = begun(tmp_path, 0)
    second = open_run(tmp_path)
    for block in range(20):
        (first if block % 3 else second).commit_block(block, *block_tables(block))
        assert first.committed_blocks() == second.committed_blocks() == frozenset(range(block + 1))
    assert len(list(first.folder.glob("journal-*"))) <= 1
    assert not verify(tmp_path).findings


def test_a_commit_that_cannot_be_written_leaves_the_journal_as_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = begun(tmp_path, 2)
    before = journal_of(store).read_bytes()

    def full(handle: int, line: bytes, at: int) -> None:
        journal.os.pwrite(handle, line[: len(line) // 2], at)
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(journal, "_write", full)
        with pytest.raises(IncompleteError, match="No space left"):
            store.commit_block(2, *block_tables(2))
    assert journal_of(store).read_bytes() == before
    store.commit_block(2, *block_tables(2))
    assert open_run(tmp_path).committed_blocks() == {0, 1, 2}
    assert not files.staged_files(store.folder)
