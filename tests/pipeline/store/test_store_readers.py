"""One writer and any number of readers: readers never see missing or half files, and a second writer is refused."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from in_process import InProcess
from store_runs import ROWS, make_run

from pipeline.errors import UsageError
from pipeline.store.lock import NAME, one_writer
from pipeline.store.query import query
from pipeline.store.read import read_run
from pipeline.store.run import open_run
from pipeline.store.verify import verify

_HOLD = "import sys; from pathlib import Path; from pipeline.store.lock import one_writer\n"
_HOLD += "with one_writer(Path(sys.argv[1])): print('held', flush=True); sys.stdin.read()"


@pytest.fixture(autouse=True)
def in_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Queries run in the process of the test, without its limits."""
    monkeypatch.setattr("pipeline.store.query.QueryProcess", InProcess)


def test_readers_see_whole_tables_and_pages_while_they_are_replaced(tmp_path: Path) -> None:
    store = make_run(tmp_path, "r")
    done = threading.Event()

    def write() -> None:
        turn = 0
        while not done.is_set():
            turn += 1
            values = {f"{n:06d}": {"p_pass_with_effects": float(turn)} for n in range(3 * ROWS)}
            store.amend_devices(values)
            store.write_file("report.html", b"<p>%06d</p>" % turn * 2000)

    writer = threading.Thread(target=write)
    writer.start()
    try:
        for _ in range(5):
            # One value in all blocks: an answer that mixes two versions has two.
            rows = query("SELECT count(*) AS n, count(DISTINCT p_pass_with_effects) AS k FROM devices", tmp_path)
            assert rows.to_pylist()[0]["n"] == 3 * ROWS
            assert rows.to_pylist()[0]["k"] <= 1
            assert len(set(read_run(tmp_path).devices.column("p_pass_with_effects").to_pylist())) == 1
            page = store.page("report.html")
            assert page is not None
            assert page == page[:13] * 2000 or page == b"<p>report</p>"
    finally:
        done.set()
        writer.join()
    assert not verify(tmp_path).findings


def test_a_second_writer_is_refused_and_told_who_holds_the_run(tmp_path: Path) -> None:
    folder = make_run(tmp_path, "r").folder
    holder = subprocess.Popen(
        [sys.executable, "-c", _HOLD, str(folder)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert holder.stdout is not None
    try:
        assert holder.stdout.readline() == "held\n"
        with pytest.raises(UsageError, match=f"process {holder.pid} on"), one_writer(folder):
            pass
        assert not verify(tmp_path).findings
    finally:
        holder.kill()
        holder.communicate()
    # The process was killed: its lock is stale.
    assert (folder / NAME).exists()
    with one_writer(folder):
        assert json.loads((folder / NAME).read_text())["pid"] != holder.pid
    assert not (folder / NAME).exists()


def test_a_process_that_dies_between_a_page_and_its_manifest_leaves_a_page_that_can_be_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from pipeline.store import files

    store = make_run(tmp_path, "r")
    replace, count = files.replace_file, 0

    def die_late(folder: Path, name: str, data: bytes) -> None:
        nonlocal count
        count += 1
        if count == 3:
            raise KeyboardInterrupt
        replace(folder, name, data)

    monkeypatch.setattr(files, "replace_file", die_late)
    with pytest.raises(KeyboardInterrupt):
        store.write_file("report.html", b"new")
    monkeypatch.undo()
    assert open_run(tmp_path).page("report.html") == b"new"
    assert not verify(tmp_path).findings
