"""gyroscreen report --limits and --json: pages, answers, and wrong input as one line with exit code 2."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tests.stub_runs import run_arguments, stub_block, stub_runs
from tests.workflows.what_if.test_against_new_runs import NEW, OLD, _run
from workflows.cli import call
from workflows.commands.what_if import page_name


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of eight devices with 100 draws each."""
    folder = tmp_path_factory.mktemp("results")
    _run(folder, OLD, "probability", 100)
    return folder


def _limits(folder: Path, text: str = "", name: str = "new.toml") -> Path:
    path = folder / name
    lines = [f"[limits.{q}]\n" + "\n".join(f"{k} = {v}" for k, v in one.items()) for q, one in NEW.items()]
    path.write_text(text or "\n".join(lines), encoding="utf-8")
    return path


def _report(results: Path, *more: str) -> int:
    return call(["report", "--results", str(results), *more])


def test_the_page_has_a_name_of_its_own_and_the_run_stays_intact(results: Path, tmp_path: Path, capsys: Any) -> None:
    assert _report(results) == 0
    own = (results / "run=r" / "report.html").read_bytes()
    tables = {path.name: path.read_bytes() for path in (results / "run=r").glob("*.parquet")}
    assert _report(results, "--limits", str(_limits(tmp_path))) == 0
    written = Path(capsys.readouterr().out.splitlines()[-1])
    assert written == results / "run=r" / "report-limits-new.html"
    assert "judged again by new.toml" in written.read_text(encoding="utf-8")
    assert (results / "run=r" / "report.html").read_bytes() == own
    assert {path.name: path.read_bytes() for path in (results / "run=r").glob("*.parquet")} == tables
    assert call(["verify", "--results", str(results)]) == 0
    assert "unchanged" in capsys.readouterr().out


def test_out_names_the_only_page_that_is_written(results: Path, tmp_path: Path, capsys: Any) -> None:
    before = sorted(path.name for path in (results / "run=r").iterdir())
    out = tmp_path / "pages" / "what.html"
    assert _report(results, "--limits", str(_limits(tmp_path)), "--out", str(out)) == 0
    assert capsys.readouterr().out.splitlines()[-1] == str(out)
    assert out.read_text(encoding="utf-8").startswith("<!DOCTYPE html>")
    assert sorted(path.name for path in (results / "run=r").iterdir()) == before


def test_json_is_one_object(results: Path, tmp_path: Path, capsys: Any) -> None:
    assert _report(results, "--limits", str(_limits(tmp_path)), "--json") == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["yield"]["old"]["devices"] == answer["yield"]["new"]["devices"] == 8
    assert answer["changed"]
    assert [one["old"] for one in answer["curves"] if one["quantity"] == "quality2"] == [None]
    assert answer["limits"]["new"]["limits"]["quality2"] == {"min": 900.0, "max": None}
    assert answer["thinning"]["stored"] == 100
    assert answer["statuses"]["misfit"] == {"old": 0, "new": 4}
    assert answer["risks"]["new"][0]["judged"] == 4
    assert len(answer["pairs"]) == 10
    capsys.readouterr()
    assert _report(results, "--json") == 0
    plain = json.loads(capsys.readouterr().out)
    assert plain["total"]["devices"] == 8
    assert [row["quantity"] for row in plain["capability"]] == list(OLD)
    assert plain["risks"][0]["quantity"] is None


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "cannot be read"),
        ("[limits.split]\nmax = 3\n", "unknown quantity"),
        ("[limits.split_hz]\nmaximum = 3\n", "unknown key"),
        ("[limits.split_hz]\nmax = nan\n", "not finite"),
        ("[limits.split_hz]\nmax = '3 Hz'\n", "not valid"),
        ("[limits.split_hz]\nmin = 3\nmax = 1\n", "crossed"),
        ("rule = 'guard'\n[limits.split_hz]\nmax = 3\n", "rule is not valid"),
        ("[limits]\n", "no limits are given"),
        ("limits", "is not TOML"),
        ("[limits.shock_limit_g]\nmin = 3\n", "knows nothing of a limited quantity"),
    ],
)
def test_wrong_limits_are_one_line_with_code_2(
    results: Path, tmp_path: Path, capsys: Any, text: str, message: str
) -> None:
    path = _limits(tmp_path, text) if text else tmp_path / "absent.toml"
    assert _report(results, "--limits", str(path), "--json") == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert len(err.splitlines()) == 1
    assert message in err


def test_the_message_says_what_is_stored(results: Path, tmp_path: Path, capsys: Any) -> None:
    assert _report(results, "--limits", str(_limits(tmp_path, "[limits.shock_limit_g]\nmin = 3\n"))) == 2
    err = capsys.readouterr().err
    assert "theta_deg, split_hz" in err
    assert "performance.md" in err


def test_wrong_runs_and_files_are_one_line_with_code_2(results: Path, tmp_path: Path, capsys: Any) -> None:
    limits = str(_limits(tmp_path))
    assert call(["report", "none", "--results", str(results), "--limits", limits]) == 2
    assert call(["report", "--results", str(tmp_path / "absent"), "--limits", limits]) == 2
    (tmp_path / "empty").mkdir()
    assert call(["report", "--results", str(tmp_path / "empty"), "--limits", limits]) == 2
    assert _report(results, "--limits", str(tmp_path)) == 2
    assert len(capsys.readouterr().err.splitlines()) == 4


@pytest.mark.parametrize("status", ["ok", "misfit"])
def test_a_run_without_numbers_or_judged_devices_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any, status: str
) -> None:
    stub_runs(monkeypatch, stub_block(status))
    call(run_arguments(tmp_path))
    capsys.readouterr()
    limits = _limits(tmp_path, "[limits.split_hz]\nmax = 3\n")
    assert call(["report", "--results", str(tmp_path / "results"), "--limits", str(limits)]) == 2
    err = capsys.readouterr().err
    assert call(["report", "--results", str(tmp_path / "results"), "--json"]) == 0
    plain = json.loads(capsys.readouterr().out)
    assert plain["total"]["devices"] == 4
    assert plain["risks"] == []
    assert {row["reason"] for row in plain["capability"]} == {"few"}
    assert len(err.splitlines()) == 1
    assert ("knows nothing" if status == "ok" else "no device of the run can be judged") in err


def test_a_run_without_common_errors_and_draws_is_judged_by_its_estimates(tmp_path: Path, capsys: Any) -> None:
    _run(tmp_path, OLD, "probability", 0)
    assert _report(tmp_path, "--limits", str(_limits(tmp_path))) == 0
    assert "stored no posterior draws" in capsys.readouterr().out


@pytest.mark.parametrize("name", ["new.toml", "a b.toml", "../x/limits.2.toml", "…", "." * 3 + "toml"])
def test_the_name_of_the_page_is_a_plain_one(name: str) -> None:
    from pipeline.store.run import PAGE

    assert PAGE.fullmatch(page_name(Path(name)))
    assert page_name(Path(name)) != "report.html"
