"""Every report says which limits judged, and where they came from."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import pytest

from pipeline.store.read import read_run
from reports import limits as reports_limits
from reports.limits import DEFAULT_FILE, DEFAULT_LIMITS, load_limits
from reports.limits_origin import LimitsOrigin, origin_of_file, recorded_origin, shipped_origin
from reports.words.limits import origin_sentence
from tests.stub_runs import run_arguments, stub_runs
from workflows import config as configuration
from workflows.cli import call
from workflows.config import config_of_run
from workflows.screening.outcome import rendered_report


def sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


@pytest.mark.parametrize("own", [False, True])
def test_page_json_and_manifest_name_the_origin(own, tmp_path, monkeypatch, capfd):
    stub_runs(monkeypatch, page=True)
    arguments = run_arguments(tmp_path, text="[limits.split_hz]\nmax = 2.0\n" if own else "")
    assert call([*arguments, "--json"]) == 0
    answer = json.loads(capfd.readouterr().out)
    file = Path(arguments[1]) if own else DEFAULT_FILE
    expected = {
        "from": "file" if own else "shipped default",
        "file": str(file) if own else file.name,
        "sha256": sha256(file),
    }
    assert answer["limits"] == expected
    assert read_run(tmp_path / "results").manifest.provenance["limits"] == expected
    page = Path(answer["report"]).read_text(encoding="utf-8")
    assert (f"[limits] of {file}" if own else f"the shipped default, {file.name}") in page
    assert expected["sha256"][:12] in page
    assert call(["report", "--results", str(tmp_path / "results"), "--against", "last:3", "--json"]) == 0
    assert json.loads(capfd.readouterr().out)["limits"] == expected


def test_a_run_keeps_the_shipped_limits_of_its_time(tmp_path, monkeypatch):
    stub_runs(monkeypatch, page=True)
    assert call(run_arguments(tmp_path)) == 0
    monkeypatch.undo()
    later = load_limits({"limits": {"split_hz": {"max": 1.0}}})
    for module in (reports_limits, configuration):
        monkeypatch.setattr(module, "DEFAULT_LIMITS", later)
    run = read_run(tmp_path / "results")
    assert config_of_run(run.config_toml, "run.toml").judged_by() == DEFAULT_LIMITS
    page = rendered_report(tmp_path / "results", run.manifest.run_id)
    assert "524.79 to 546.21" in page


def test_a_run_of_an_older_version_says_what_its_configuration_shows():
    assert recorded_origin({}, stated=False) == shipped_origin()
    assert recorded_origin({"limits": "nonsense"}, stated=True) == LimitsOrigin("file")
    assert "is not recorded" in origin_sentence(LimitsOrigin("file"))


def test_limits_of_the_command_line_are_called_so(tmp_path):
    path = tmp_path / "new.toml"
    path.write_text("[limits.split_hz]\nmax = 1.0\n", encoding="utf-8")
    origin = origin_of_file(path, "command line")
    assert origin.to_dict() == {"from": "command line", "file": str(path), "sha256": sha256(path)}
    assert recorded_origin({"limits": origin.to_dict()}, stated=True) == origin
    assert "not those by which the run was judged" in origin_sentence(origin)
