"""Small block files become larger ones: the tables stay, whatever the order of commits and wherever a process dies."""

from __future__ import annotations

import os
import threading
from pathlib import Path

import pytest
from store_runs import CONFIG, PROVENANCE, ROWS, block_tables, make_run

from pipeline.store import checkpoint, journal
from pipeline.store.query import query
from pipeline.store.read import read_run
from pipeline.store.run import RunStore, create_run
from pipeline.store.verify import verify

#: 18 for the figure of docs/explanation/faults.md.
QUERIES = int(os.environ.get("QUERIES", "2"))


@pytest.fixture(autouse=True)
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Groups of 4 blocks, checkpoints every 3 commits, and a rest of 2 blocks that is merged at the end."""
    monkeypatch.setattr(checkpoint, "BLOCKS", 4)
    monkeypatch.setattr(checkpoint, "_LEAST_REST", 2)
    monkeypatch.setattr(journal, "_LEAST_LINES", 3)


def tables_of(store: RunStore) -> list[str]:
    return sorted(path.name for path in store.folder.glob("*.parquet"))


def test_whole_groups_are_merged_and_the_rows_stay(tmp_path: Path) -> None:
    store = create_run(tmp_path, "r", CONFIG, PROVENANCE)
    for block in (0, 1, 2, 5, 3, 4, 6, 9, 8):
        store.commit_block(block, *block_tables(block))
    merged = ["00000-00003", "00004", "00005", "00006", "00008", "00009"]
    assert tables_of(store) == [f"{kind}-{name}.parquet" for kind in ("devices", "posterior") for name in merged]
    assert store.committed_blocks() == {0, 1, 2, 3, 4, 5, 6, 8, 9}
    assert not [finding for finding in verify(tmp_path).findings if "gaps" not in finding.expected]
    store.commit_block(7, *block_tables(7))
    store.commit_block(2, *block_tables(2, seed=8))  # is there already
    store.finish("complete", {})
    merged = ["00000-00003", "00004-00007", "00008-00009"]
    assert tables_of(store) == [f"{kind}-{name}.parquet" for kind in ("devices", "posterior") for name in merged]
    assert not verify(tmp_path).findings
    found = read_run(tmp_path)
    for block in range(10):
        devices, posterior = block_tables(block)
        assert found.devices.slice(block * ROWS, ROWS).equals(devices)
        assert found.posterior.slice(block * posterior.num_rows, posterior.num_rows).equals(posterior)
    count = query("SELECT count(*) AS n, count(DISTINCT device_id) AS k FROM devices", tmp_path).to_pylist()
    assert count == [{"n": 10 * ROWS, "k": 10 * ROWS}]
    in_order = make_run(tmp_path / "other", "r", blocks=tuple(range(10)))
    assert {(f.name, f.sha256) for f in in_order.manifest.files} >= {(f.name, f.sha256) for f in found.manifest.files}


def test_merged_tables_can_be_amended(tmp_path: Path) -> None:
    store = make_run(tmp_path, "r", blocks=tuple(range(8)))
    for value in (0.25, 0.5, 0.75):
        store.amend_devices({"000005": {"p_pass_with_effects": value}})
        column = read_run(tmp_path).devices.column("p_pass_with_effects").to_pylist()
        assert [n for n, one in enumerate(column) if one is not None] == [5]
        assert column[5] == value
        assert not verify(tmp_path).findings


def test_large_files_are_cut_and_single_ones_stay(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    one = make_run(tmp_path / "a", "r", blocks=(0,)).manifest.of_kind("devices")[0].bytes
    monkeypatch.setattr(checkpoint, "MOST_BYTES", 2 * one + one // 2)
    store = make_run(tmp_path / "b", "r", blocks=tuple(range(5)))
    devices = [name for name in tables_of(store) if name.startswith("devices")]
    assert devices == ["devices-00000-00001.parquet", "devices-00002-00003.parquet", "devices-00004.parquet"]
    assert not verify(tmp_path / "b").findings


def test_a_damaged_block_is_not_merged_and_does_not_end_the_night(tmp_path: Path) -> None:
    store = create_run(tmp_path, "r", CONFIG, PROVENANCE)
    for block in range(9):
        store.commit_block(block, *block_tables(block))
        if block == 1:
            path = store.folder / "devices-00001.parquet"
            path.write_bytes(path.read_bytes()[:-1] + b"?")
    assert [finding.file for finding in verify(tmp_path).errors] == [str(path)]
    assert store.committed_blocks() == frozenset(range(9))


def test_readers_see_whole_tables_while_files_are_merged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(journal, "_LEAST_LINES", 8)
    store, done, written = create_run(tmp_path, "r", CONFIG, PROVENANCE), threading.Event(), [0]

    def write() -> None:
        for block in range(2000):
            if done.is_set():
                return
            store.commit_block(block, *block_tables(block))
            written[0] = block + 1
            done.wait(0.05)

    writer = threading.Thread(target=write)
    writer.start()
    try:
        for _ in range(QUERIES):
            before = written[0]
            sql = "SELECT count(*) AS n, count(DISTINCT device_id) AS k, max(device_id) AS last FROM devices"
            found = query(sql, tmp_path).to_pylist()[0]
            assert found["n"] == found["k"] >= ROWS * before
            assert found["n"] == (0 if found["last"] is None else int(found["last"]) + 1)
            assert read_run(tmp_path).devices.num_rows >= found["n"]
    finally:
        done.set()
        writer.join()
    assert verify(tmp_path).ok
