"""`verify` finds damage in every file of a run; `verify --repair` computes damaged tables again and stores them only if equal."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pipeline.store import log
from pipeline.store.run import open_run
from tests.drawn_devices import drawn_block
from tests.stub_runs import run_arguments, stub_block, stub_runs
from workflows.cli import call
from workflows.screening import repair as repairs
from workflows.screening.guard import unguarded


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Folder of a finished run of six devices in three blocks."""
    stub_runs(monkeypatch)
    repairs_compute(monkeypatch, stub_block())
    assert call(run_arguments(tmp_path, devices=6)) == 0
    return next((tmp_path / "results").glob("run=*"))


def repairs_compute(patch: pytest.MonkeyPatch, block: Callable[..., Any]) -> None:
    """Repairs compute ``block`` in this process."""

    @contextmanager
    def cluster(*_: Any) -> Iterator[Any]:
        yield SimpleNamespace()

    def in_turn(_: Any, function: Any, given: Any, items: Any, *__: Any, **___: Any) -> Iterator[Any]:
        return ((item, function(given, item, unguarded)) for item in items)

    patch.setattr(repairs, "cluster", cluster)
    patch.setattr(repairs, "guarded_in_parallel", in_turn)
    patch.setattr(repairs, "block_task", lambda config, item, _: block((config, item.campaigns), item.block))


def verify(folder: Path, *more: str) -> int:
    return call(["verify", "--results", str(folder.parent), *more])


def flip(path: Path, seed: int = 1) -> bytes:
    data = path.read_bytes()
    damaged = bytearray(data)
    damaged[int(np.random.default_rng(seed).integers(len(data)))] ^= 4
    path.write_bytes(damaged)
    return data


def names(folder: Path) -> list[str]:
    files = [path.name for path in folder.iterdir() if path.is_file() and path.name != "manifest.json"]
    return sorted(files)


def test_stored_irregularities_are_drawn_again(tmp_path, monkeypatch, capfd):
    stub_runs(monkeypatch, drawn_block)
    repairs_compute(monkeypatch, drawn_block)
    assert call(run_arguments(tmp_path, devices=4)) == 0
    folder = next((tmp_path / "results").glob("run=*"))
    sound = flip(folder / "irregularities-00001.parquet")
    assert verify(folder) == 4
    assert "irregularities-00001.parquet" in capfd.readouterr().err
    assert verify(folder, "--repair") == 0
    assert (folder / "irregularities-00001.parquet").read_bytes() == sound


def test_damage_in_any_file_of_a_run_is_found_and_named(folder, capfd):
    assert verify(folder) == 0
    for name in names(folder):
        for seed in range(1):
            sound = flip(folder / name, seed)
            capfd.readouterr()
            assert verify(folder) == 4
            assert f"damage: {folder / name}" in capfd.readouterr().out
            (folder / name).write_bytes(sound[: len(sound) // 2])
            assert verify(folder) == 4
            (folder / name).write_bytes(sound)
    assert verify(folder) == 0


def test_a_repair_restores_what_was_committed_and_keeps_the_damaged_files(folder, capfd):
    repairable = [name for name in names(folder) if name.startswith("devices") or name == "inputs.json"]
    before = {name: flip(folder / name) for name in repairable}
    damaged = {name: (folder / name).read_bytes() for name in repairable}
    flip(folder / "report.html")
    flip(folder / log.NAME)
    assert verify(folder, "--repair") == 0
    out = capfd.readouterr().out
    for name, sound in before.items():
        assert (folder / name).read_bytes() == sound
        assert f"repaired: {folder / name}" in out
        kept = list((folder / "damaged").glob(f"{name}.*"))
        assert [path.read_bytes() for path in kept] == [damaged[name]]
    assert len(list((folder / "damaged").iterdir())) == len(repairable) + 2
    assert verify(folder) == 0
    assert verify(folder, "--repair", "--json") == 0
    assert json.loads(capfd.readouterr().out.splitlines()[-1])["repair"] == []


def test_a_table_that_is_computed_otherwise_is_not_stored(folder, monkeypatch, capfd):
    path = folder / "devices-00001.parquet"
    flip(path)
    damaged = path.read_bytes()
    repairs_compute(monkeypatch, stub_block("misfit"))
    assert verify(folder, "--repair") == 4
    assert "not repaired: " in capfd.readouterr().out
    assert path.read_bytes() == damaged


def test_what_only_a_run_itself_holds_is_not_repaired(folder, capfd):
    for name in ("run.toml", "manifest.json"):
        sound = flip(folder / name)
        assert verify(folder, "--repair") == 4
        assert "restore" in capfd.readouterr().out
        (folder / name).write_bytes(sound)


def test_commits_that_a_damaged_journal_lost_are_not_lost_silently(tmp_path, monkeypatch, capfd):
    """A journal cut at a line looks like that of a younger run; the log tells them apart."""
    stub_runs(monkeypatch)
    made = stub_block()

    def interrupted(source: Any, at: Any) -> Any:
        if at.index == 3:
            raise KeyboardInterrupt
        return made(source, at)

    stub_runs(monkeypatch, interrupted)
    monkeypatch.setattr("pipeline.store.run.RunStore.finish", lambda *_: None)
    assert call(run_arguments(tmp_path, devices=10)) == 130
    monkeypatch.undo()
    stub_runs(monkeypatch)
    results = tmp_path / "results"
    folder = next(results.glob("run=*"))
    journal = next(folder.glob("journal-*"))
    whole = journal.read_bytes()
    assert whole.count(b"\n") == 3
    for damaged in (b"", whole[: whole.rfind(b"\n", 0, -1) + 1], whole[:-7], whole.replace(b"devices", b"bevices", 1)):
        journal.write_bytes(damaged)
        for command in (["query", "SELECT 1"], ["verify"], ["report"]):
            assert call([*command, "--results", str(results)]) == 4, command
            assert journal.name in capfd.readouterr().err
        assert call(["run", "--resume", "latest", "--out", str(results)]) == 4
    journal.write_bytes(whole[: whole.rfind(b"\n", 0, -1) + 9])
    assert verify(folder, "--repair") == 0
    assert "run --resume" in capfd.readouterr().out
    assert call(["run", "--resume", "latest", "--out", str(results)]) == 0
    assert open_run(results).devices().num_rows == 10
    assert verify(folder) == 0
