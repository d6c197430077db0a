"""A run interrupted at any moment holds whole blocks only, and after a resume its tables are identical."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from store_runs import CONFIG, PROVENANCE, ROWS, block_tables, make_run

from pipeline.errors import ConfigError, IncompleteError, IntegrityError, UsageError
from pipeline.store import files
from pipeline.store import run as run_module
from pipeline.store.digest import table_digest
from pipeline.store.read import list_runs, read_run
from pipeline.store.run import RunStore, create_run, open_run
from pipeline.store.verify import verify

HERE = Path(__file__).parent
BLOCKS = 12


class Crash(BaseException):
    """The process ends here."""


def assert_same_tables(one: RunStore, other: RunStore) -> None:
    first, second = (read_run(store.folder.parent, store.run_id) for store in (one, other))
    assert first.devices.equals(second.devices)
    assert first.posterior.equals(second.posterior)
    assert first.manifest.devices_digest == second.manifest.devices_digest
    hashes = [{(f.name, f.sha256) for f in run.manifest.files if f.kind != "page"} for run in (first, second)]
    assert hashes[0] == hashes[1]


def test_tables_come_back_in_block_order_with_units(tmp_path: Path) -> None:
    make_run(tmp_path, "r", blocks=(2, 0, 1))
    run = read_run(tmp_path, "r")
    assert run.devices.column("device_id").to_pylist() == [f"{n:06d}" for n in range(3 * ROWS)]
    assert run.devices.schema.field("split_hz").metadata[b"unit"] == b"Hz"
    assert run.config_toml == CONFIG
    assert run.manifest.status == "complete"
    assert run.manifest.devices_digest == table_digest(run.devices)
    assert run.manifest.provenance == PROVENANCE


def test_order_of_commits_leaves_the_same_table(tmp_path: Path) -> None:
    assert_same_tables(make_run(tmp_path, "ordered"), make_run(tmp_path, "shuffled", blocks=(1, 2, 0)))


def test_a_page_whose_replacement_is_interrupted_twice_stays_valid(tmp_path: Path, monkeypatch) -> None:
    """The second interruption may leave the page of the first, which had not been listed alone."""
    store = create_run(tmp_path, "r", CONFIG, PROVENANCE)
    store.write_file("report.html", b"first")

    def interrupted(*_args):
        raise KeyboardInterrupt

    with monkeypatch.context() as once:
        written: list[int] = []
        put = run_module.put_manifest
        once.setattr(run_module, "put_manifest", lambda *a: put(*a) if not written else interrupted())
        replace_file = run_module.files.replace_file
        once.setattr(run_module.files, "replace_file", lambda *a: (replace_file(*a), written.append(1)))
        with pytest.raises(KeyboardInterrupt):
            store.write_file("report.html", b"second")
    assert verify(tmp_path).ok
    with monkeypatch.context() as again:
        replace_file = run_module.files.replace_file
        again.setattr(
            run_module.files, "replace_file", lambda *a: interrupted() if a[1] == "report.html" else replace_file(*a)
        )
        with pytest.raises(KeyboardInterrupt):
            open_run(tmp_path, "r").write_file("report.html", b"third")
    assert (tmp_path / "run=r" / "report.html").read_bytes() == b"second"
    assert verify(tmp_path).ok


@pytest.mark.skipif(sys.platform == "win32", reason="needs fork and SIGKILL")
def test_killed_writers_leave_whole_blocks_and_a_resume_gives_the_undisturbed_table(tmp_path: Path) -> None:
    undisturbed = make_run(tmp_path / "undisturbed", "r", blocks=tuple(range(BLOCKS)))
    create_run(tmp_path, "killed", CONFIG, PROVENANCE)
    killed = 0
    for round_ in range(5):
        command = [
            sys.executable,
            str(HERE / "kill_writers.py"),
            str(tmp_path),
            "killed",
            str(BLOCKS),
            "6",
            str(round_),
        ]
        done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=HERE.parents[2])
        killed += int(done.stdout)
        report = verify(tmp_path)
        assert report.ok, report.findings
        run = read_run(tmp_path, "killed")
        blocks = sorted(run.manifest.blocks())
        assert run.devices.num_rows == ROWS * len(blocks)
        for place, block in enumerate(blocks):
            assert run.devices.slice(place * ROWS, ROWS).equals(block_tables(block)[0])
    assert killed >= 20
    store = open_run(tmp_path, "killed")
    for block in range(BLOCKS):
        store.commit_block(block, *block_tables(block))
    store.finish("complete", {})
    assert_same_tables(undisturbed, store)
    assert files.staged_files(store.folder) == ()


def crash_at(monkeypatch: pytest.MonkeyPatch, moment: int) -> None:
    """Let the process end at its ``moment``-th step on disk (before and after each; writes half done)."""
    steps = 0

    def step() -> bool:
        nonlocal steps
        steps += 1
        return steps == moment

    def wrap(name: str, half: Callable[..., Any] | None = None) -> None:
        original = getattr(files, name)

        def wrapped(*arguments: Any) -> Any:
            if step():
                if half is not None:
                    half(original, *arguments)
                raise Crash
            result = original(*arguments)
            if step():
                raise Crash
            return result

        monkeypatch.setattr(files, name, wrapped)

    wrap("stage", lambda stage, folder, name, data: stage(folder, name, bytes(data)[: len(data) // 2]))
    wrap("publish")
    wrap("fsync_folder")


def write_run(store: RunStore) -> None:
    store.commit_block(0, *block_tables(0))
    for page in (b"first", b"second"):
        store.write_file("report.html", page)
    store.finish("complete", {})


def test_after_a_crash_at_any_disk_operation_committed_blocks_are_whole(tmp_path: Path) -> None:
    undisturbed = create_run(tmp_path, "undisturbed", CONFIG, PROVENANCE)
    write_run(undisturbed)
    moment, finished = 0, False
    while not finished:
        moment += 1
        results = tmp_path / str(moment)
        store = create_run(results, "r", CONFIG, PROVENANCE)
        with pytest.MonkeyPatch.context() as monkeypatch:
            crash_at(monkeypatch, moment)
            try:
                write_run(store)
                finished = True
            except Crash:
                pass
        report = verify(results)
        assert report.ok, (moment, report.findings)
        assert report.devices == ROWS * len(store.committed_blocks())
        if store.manifest.status != "complete":
            write_run(open_run(results, "r"))
        assert_same_tables(undisturbed, store)
        assert not files.staged_files(store.folder)
    assert moment > 30


def test_a_full_disk_is_an_incomplete_error_and_keeps_committed_blocks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = create_run(tmp_path, "r", CONFIG, PROVENANCE)
    store.commit_block(0, *block_tables(0))

    def full(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(files, "stage", full)
        with pytest.raises(IncompleteError, match=r"No space left on device.*--resume"):
            store.commit_block(1, *block_tables(1))
    assert store.committed_blocks() == {0}
    store.commit_block(1, *block_tables(1))
    assert verify(tmp_path).ok


def test_committing_a_block_again_leaves_it_unchanged(tmp_path: Path) -> None:
    store = create_run(tmp_path, "r", CONFIG, PROVENANCE)
    store.commit_block(0, *block_tables(0))
    before = store.manifest
    store.commit_block(0, *block_tables(0, seed=8))
    assert store.manifest == before
    assert read_run(tmp_path, "r").devices.equals(block_tables(0)[0])


def test_concurrent_writers_lose_no_block(tmp_path: Path) -> None:
    create_run(tmp_path, "r", CONFIG, PROVENANCE)
    with ThreadPoolExecutor(4) as pool:
        jobs = [pool.submit(open_run(tmp_path, "r").commit_block, n // 2, *block_tables(n // 2)) for n in range(32)]
        for job in jobs:
            job.result()
    assert open_run(tmp_path, "r").committed_blocks() == frozenset(range(16))
    assert not verify(tmp_path).findings


def test_stopped_runs_accept_blocks_and_complete_runs_refuse_them(tmp_path: Path) -> None:
    store = create_run(tmp_path, "r", CONFIG, PROVENANCE)
    store.commit_block(1, *block_tables(1))
    with pytest.raises(IncompleteError, match=r"lacks blocks: \[0\]"):
        store.finish("complete", {})
    store.finish("stopped", {})
    store.commit_block(0, *block_tables(0))
    assert (store.manifest.status, store.manifest.devices_digest) == ("running", None)
    store.finish("complete", {"yield": 0.5})
    assert store.manifest.summary == {"yield": 0.5}
    with pytest.raises(UsageError, match="is complete and accepts no further blocks: 2"):
        store.commit_block(2, *block_tables(2))


def test_runs_without_draws_read_as_an_empty_posterior(tmp_path: Path) -> None:
    store = create_run(tmp_path, "r", CONFIG, PROVENANCE)
    store.commit_block(0, block_tables(0)[0], None)
    run = read_run(tmp_path)
    assert (run.devices.num_rows, run.posterior.num_rows) == (ROWS, 0)


def test_wrong_blocks_are_refused_before_anything_is_written(tmp_path: Path) -> None:
    store = create_run(tmp_path, "r", CONFIG, PROVENANCE)
    devices, posterior = block_tables(0)
    with pytest.raises(IntegrityError, match=r"devices is not in the registered schema: \['theta_deg'\]"):
        store.commit_block(0, devices.drop_columns(["theta_deg"]), None)
    with pytest.raises(IntegrityError, match="lists a device more than once"):
        store.commit_block(0, devices.take([0, 1, 1]), None)
    with pytest.raises(IntegrityError, match="draws of devices that are not in the block"):
        store.commit_block(0, devices.slice(1), posterior)
    assert sorted(path.name for path in store.folder.iterdir()) == ["manifest.json", "run.toml"]
    store.commit_block(0, devices, None)
    store.commit_block(1, devices, None)
    with pytest.raises(IntegrityError, match="lists a device more than once"):
        store.finish("complete", {})


def test_existing_and_invalid_run_names_are_refused(tmp_path: Path) -> None:
    make_run(tmp_path, "r")
    with pytest.raises(ConfigError, match=r"a run of that name exists: 'r'.*--resume r"):
        create_run(tmp_path, "r", CONFIG, PROVENANCE)
    assert not verify(tmp_path).findings
    for name in ("", "../r", "a/b", ".hidden", "x" * 101):
        with pytest.raises(ConfigError, match="not the name of a run"):
            create_run(tmp_path, name, CONFIG, PROVENANCE)


def test_results_that_cannot_be_a_folder_are_a_config_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError, match=r"cannot write to the results folder.*--out"):
        create_run(tmp_path / "file", "r", CONFIG, PROVENANCE)


def test_the_newest_run_is_the_default_and_missing_ones_are_named(tmp_path: Path) -> None:
    for results in (tmp_path, tmp_path / "nowhere"):
        assert list_runs(results) == ()
        with pytest.raises(UsageError, match=r"results folder holds no runs.*gyroscreen run"):
            read_run(results)
    for name in ("b", "a"):
        make_run(tmp_path, name)
    assert read_run(tmp_path).manifest.run_id == "a"
    assert [manifest.run_id for manifest in list_runs(tmp_path)] == ["b", "a"]
    with pytest.raises(UsageError, match="no such run: 'c'; allowed: a, b"):
        open_run(tmp_path, "c")


def test_only_pages_may_be_replaced(tmp_path: Path) -> None:
    store = make_run(tmp_path, "r")
    store.write_file("report.html", b"new")
    assert verify(tmp_path).ok
    for name in (
        "manifest.json",
        "run.toml",
        "log.jsonl",
        "devices-00000.parquet",
        "../x.html",
        ".report.html",
    ):
        with pytest.raises(UsageError, match="not the name of a page"):
            store.write_file(name, b"")


def test_summaries_that_are_not_json_are_refused(tmp_path: Path) -> None:
    store = create_run(tmp_path, "r", CONFIG, PROVENANCE)
    with pytest.raises(UsageError, match="is not JSON"):
        store.finish("stopped", {"yield": float("nan")})
    assert store.manifest.status == "running"


def test_every_log_line_is_json(tmp_path: Path) -> None:
    store = create_run(tmp_path, "r", CONFIG, PROVENANCE)
    store.log({"event": "block", "rate": float("nan"), "where": Path("a"), "text": "two\nlines"})
    store.log({"event": "end"})
    first, second = map(json.loads, (store.folder / "log.jsonl").read_text().splitlines())
    assert len(first.pop("sha256")) == 16
    assert {**first, "time": ""} == {"time": "", "event": "block", "rate": None, "where": "a", "text": "two\nlines"}
    assert second["time"] >= first["time"]


def test_a_crash_while_a_run_is_created_leaves_a_whole_run_or_none(tmp_path: Path) -> None:
    for moment in range(1, 14):
        results = tmp_path / str(moment)
        with pytest.MonkeyPatch.context() as monkeypatch:
            crash_at(monkeypatch, moment)
            monkeypatch.setattr("pipeline.store.run.shutil.rmtree", lambda *_, **__: None)  # the dead do not tidy
            with pytest.raises(Crash):
                create_run(results, "r", CONFIG, PROVENANCE)
        if not list_runs(results):
            create_run(results, "r", CONFIG, PROVENANCE)
        assert open_run(results, "r").config_toml == CONFIG
        assert verify(results).ok
