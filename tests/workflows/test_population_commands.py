"""gyroscreen population, and runs on populations that extend others."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from pipeline.store.digest import table_digest
from pipeline.store.read import read_run
from populations.spec import load_spec
from tests.drawn_devices import drawn_block
from tests.stub_runs import CONFIG, stub_runs
from workflows.cli import call


def digest(results: Path) -> str:
    return table_digest(read_run(results).devices)


def config(folder: Path, spec: str) -> Path:
    path = folder / f"{Path(spec).stem}-night.toml"
    path.write_text(CONFIG.format(devices=6) + f'[source]\nspec = "{spec}"\n', encoding="utf-8")
    return path


def test_the_shown_population_is_accepted_by_run_and_gives_the_same_devices(tmp_path, monkeypatch, capsys):
    assert call(["population", "show"]) == 0
    (tmp_path / "shown.toml").write_text(capsys.readouterr().out, encoding="utf-8")
    stub_runs(monkeypatch, drawn_block)
    for spec in ("cloverleaf", "shown.toml"):
        assert call(["run", str(config(tmp_path, spec)), "--out", str(tmp_path / f"of-{Path(spec).stem}")]) == 0
    assert digest(tmp_path / "of-shown") == digest(tmp_path / "of-cloverleaf")


def test_add_show_and_drop(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert call(["population", "add", "lid_leak", "mine.toml"]) == 0
    path = tmp_path / "mine.toml"
    path.write_text(path.read_text(encoding="utf-8").replace("fraction = 0.03", "fraction = 0.5"), encoding="utf-8")
    assert load_spec(path).irregularity["lid_leak"]["fraction"] == 0.5
    capsys.readouterr()
    assert call(["population", "show", "mine.toml"]) == 0
    assert "fraction = 0.5 " in capsys.readouterr().out
    assert call(["population", "drop", "lid_leak", "mine.toml"]) == 0
    assert "lid_leak" not in capsys.readouterr().out
    assert "lid_leak" not in load_spec(path).irregularity


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["show", "clover"], "did you mean cloverleaf?"),
        (["show", "gone.toml"], "cannot be read"),
        (["add", "no_such", "new.toml"], "unknown irregularity"),
        (["add", "lid_leak", "new.txt"], "ends in .toml"),
        (["add", "lid_leak", "broken.toml"], "is not TOML"),
        (["add", "lid_leak", "no/such/folder/new.toml"], "cannot be written"),
        (["drop", "lid_leak", "gone.toml"], "no such population file"),
        (["drop", "lid_leek", "mine.toml"], "did you mean lid_leak?"),
    ],
)
def test_what_cannot_be_done_is_one_line_with_exit_code_2(tmp_path, monkeypatch, capsys, arguments, says):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.toml").write_text('extends = "cloverleaf"\n', encoding="utf-8")
    (tmp_path / "broken.toml").write_text("extends = \n", encoding="utf-8")
    assert call(["population", *arguments]) == 2
    message = capsys.readouterr().err
    assert says in message
    assert message.count("\n") == 1
    assert not (tmp_path / "new.toml").exists()
    assert (tmp_path / "mine.toml").read_text(encoding="utf-8") == 'extends = "cloverleaf"\n'


def test_all_files_of_a_chain_are_inputs_and_a_resumed_run_uses_their_copies(tmp_path, monkeypatch, capfd):
    base = tmp_path / "base.toml"
    base.write_text('name = "base"\nextends = "cloverleaf"\n[device]\nrocking_hz = 530.0\n', encoding="utf-8")
    (tmp_path / "top.toml").write_text('extends = "base.toml"\nwithout = ["lid_leak"]\n', encoding="utf-8")
    night = config(tmp_path, "top.toml")

    def interrupted(source, at):
        if at.index:
            raise KeyboardInterrupt
        return drawn_block(source, at)

    stub_runs(monkeypatch, drawn_block)
    assert call(["run", str(night), "--out", str(tmp_path / "whole")]) == 0
    stub_runs(monkeypatch, interrupted)
    results = tmp_path / "results"
    assert call(["run", str(night), "--out", str(results)]) == 130
    folder = next(results.glob("run=*"))
    inputs = json.loads((folder / "inputs.json").read_text(encoding="utf-8"))
    named = [Path(one["path"]).name for one in inputs["files"] if one["what"] == "population"]
    assert named == ["top.toml", "base.toml", "cloverleaf.toml"]
    assert all(one["sha256"] in inputs["texts"] for one in inputs["files"])

    base.write_text('name = "base"\nextends = "cloverleaf"\n[device]\nrocking_hz = 560.0\n', encoding="utf-8")
    stub_runs(monkeypatch, drawn_block)
    capfd.readouterr()
    assert call(["run", str(night), "--resume", "latest", "--out", str(results)]) == 2
    assert "population.device.rocking_hz: 530.0 -> 560.0" in capfd.readouterr().err
    assert call(["run", "--resume", "latest", "--out", str(results)]) == 0
    assert "base.toml has changed since the run started; the run uses its own copy" in capfd.readouterr().err
    assert digest(results) == digest(tmp_path / "whole")
    base.unlink()
    assert call(["report", "--results", str(results)]) == 0


def test_a_chain_that_extends_itself_ends_a_run_before_the_first_device(tmp_path, capsys):
    (tmp_path / "one.toml").write_text('extends = "two.toml"\n', encoding="utf-8")
    (tmp_path / "two.toml").write_text('extends = "one.toml"\n', encoding="utf-8")
    assert call(["run", str(config(tmp_path, "one.toml")), "--out", str(tmp_path / "results")]) == 2
    assert "a population extends itself: 'one.toml -> two.toml -> one.toml'" in capsys.readouterr().err
    assert not (tmp_path / "results").exists()
