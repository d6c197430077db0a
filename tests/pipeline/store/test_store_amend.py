"""Columns of committed devices are amended after the last block: atomically, and without changing anything else."""

from __future__ import annotations

from pathlib import Path

import pyarrow.parquet as pq
import pytest
from store_runs import ROWS, make_run

from pipeline.errors import UsageError
from pipeline.store import files
from pipeline.store.digest import table_digest
from pipeline.store.manifest import encode
from pipeline.store.read import read_run
from pipeline.store.run import RunStore, create_run, open_run
from pipeline.store.verify import verify

VALUES = {
    "000001": {"missing_effect": "cubic_stiffness", "p_pass_with_effects": 0.5},
    "000009": {"missing_effect": "unknown"},
}


class Crash(BaseException):
    """The process ends here."""


def amend(results: Path) -> RunStore:
    store = open_run(results)
    store.amend_devices(VALUES)
    store.finish("complete", {})
    return store


def test_amended_devices_read_back_and_everything_else_is_as_it_was(tmp_path: Path) -> None:
    make_run(tmp_path, "r")
    before = read_run(tmp_path).devices.to_pylist()
    amend(tmp_path)
    after = read_run(tmp_path)
    for old, new in zip(before, after.devices.to_pylist()):
        assert new == old | VALUES.get(old["device_id"], {})
    assert after.posterior.num_rows == 15 * ROWS
    assert verify(tmp_path).ok
    assert not verify(tmp_path).findings


def test_amending_again_changes_nothing_and_other_values_replace_the_first(tmp_path: Path) -> None:
    make_run(tmp_path, "r")
    first = amend(tmp_path).manifest.files
    assert amend(tmp_path).manifest.files == first
    open_run(tmp_path).amend_devices({"000001": {"missing_effect": None, "p_pass_with_effects": None}})
    assert read_run(tmp_path).devices.to_pylist()[1]["missing_effect"] is None
    with pytest.raises(UsageError, match="no such column"):
        open_run(tmp_path).amend_devices({"000001": {"mood": "good"}})


@pytest.mark.parametrize("step", range(6))
def test_a_process_that_dies_while_amending_leaves_the_old_tables_or_the_new(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: int
) -> None:
    make_run(tmp_path, "r")
    before = table_digest(read_run(tmp_path).devices)
    whole, count = files.publish, iter(range(100))

    def dies(folder: Path, name: str) -> None:
        if next(count) == step:
            raise Crash
        whole(folder, name)

    with monkeypatch.context() as patched:
        patched.setattr(files, "publish", dies)
        try:
            open_run(tmp_path).amend_devices(VALUES)
        except Crash:
            assert table_digest(read_run(tmp_path).devices) == before
    assert verify(tmp_path).ok
    amend(tmp_path)
    assert read_run(tmp_path).devices.to_pylist()[1]["missing_effect"] == "cubic_stiffness"


def test_a_run_from_before_a_column_was_registered_is_sound_and_reads_null(tmp_path: Path) -> None:
    make_run(tmp_path, "r")
    folder = create_run(tmp_path / "old", "r", "seed = 7\n", {}).folder
    for path in (tmp_path / "run=r").iterdir():
        (folder / path.name).write_bytes(path.read_bytes())
    store = open_run(tmp_path / "old")
    entries = []
    for entry in store.manifest.files:
        if entry.kind == "devices":
            path = folder / entry.name
            # A file, not a data set, whose folder would lend it a column.
            table = pq.ParquetFile(path).read()
            pq.write_table(table.drop_columns(["missing_effect"]), path, write_page_checksum=True)
            data = path.read_bytes()
            entry = type(entry)(entry.name, entry.kind, len(data), files.sha256(data), entry.block, entry.rows)
        entries.append(entry)
    old = read_run(tmp_path).devices.drop_columns(["missing_effect"])
    manifest = type(store.manifest)(
        **{**vars(store.manifest), "files": tuple(entries), "devices_digest": table_digest(old)}
    )
    (folder / "manifest.json").write_bytes(encode(manifest))
    assert verify(tmp_path / "old").ok
    assert read_run(tmp_path / "old").devices.column("missing_effect").null_count == 3 * ROWS
