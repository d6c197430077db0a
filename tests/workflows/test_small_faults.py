"""Faults on the edge: folders that cannot be written, links, control characters, numbers that no one measures."""

from __future__ import annotations

import errno
import json
import re
import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from pipeline.errors import IncompleteError, UsageError, printable_lines
from pipeline.store import files
from pipeline.store.read import list_runs
from pipeline.store.run import RunStore, open_run
from pipeline.store.schema import devices_table
from pipeline.store.verify import verify
from reports.html.rendering import environment
from tests.stub_runs import run_arguments, stub_block, stub_runs
from workflows.cli import call


@pytest.fixture
def results(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A finished run of four devices."""
    stub_runs(monkeypatch)
    assert call(run_arguments(tmp_path)) == 0
    return tmp_path / "results"


@pytest.mark.parametrize("late", ["journal", "devices-00007.parquet"])
def test_a_commit_that_fails_late_leaves_no_stray_file(late, tmp_path, monkeypatch):
    from pipeline.store import journal
    from pipeline.store.provenance import provenance
    from pipeline.store.run import create_run

    store = create_run(tmp_path, "r", "", provenance(1))
    publish = files.publish

    def failing(folder: Path, name: str) -> None:
        if name == late:
            raise OSError(errno.ENOSPC, "No space left on device")
        publish(folder, name)

    before = sorted(path.name for path in store.folder.iterdir())
    table = devices_table({"device_id": ["D1"]})

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    if late == "journal":
        monkeypatch.setattr(journal, "_write", full)
    monkeypatch.setattr(files, "publish", failing)
    with pytest.raises(IncompleteError):
        store.commit_block(7, table, None)
    names = sorted(path.name for path in store.folder.iterdir())
    assert [name for name in names if "devices" in name] == []
    assert set(before) <= set(names)
    monkeypatch.undo()
    store.commit_block(7, table, None)
    assert store.committed_blocks() == {7}
    assert verify(tmp_path).ok


def test_a_report_goes_elsewhere_although_the_results_are_read_only(results, tmp_path, monkeypatch, capfd):
    def read_only(*_: Any) -> None:
        raise IncompleteError("cannot write to the run")

    monkeypatch.setattr(RunStore, "write_file", read_only)
    assert call(["report", "--results", str(results), "--out", str(tmp_path / "page.html")]) == 0
    assert (tmp_path / "page.html").exists()
    capfd.readouterr()
    assert call(["report", "--results", str(results)]) == 3


def test_a_link_is_no_run(results, tmp_path, capfd):
    other = tmp_path / "other"
    other.mkdir()
    run = next(results.glob("run=*"))
    try:
        (other / run.name).symlink_to(run, target_is_directory=True)
    except OSError:
        pytest.skip("links are not allowed here")
    assert list_runs(other) == ()
    with pytest.raises(UsageError):
        open_run(other)
    assert call(["query", "SELECT 1", "--results", str(other)]) == 2


def test_control_characters_of_ids_do_not_reach_the_terminal(tmp_path, monkeypatch, capfd):
    stub_runs(monkeypatch, stub_block("fit_failed", "record \x1b[31mred\x1b[0m.csv\r"))
    assert call(run_arguments(tmp_path)) == 1
    assert call(["identify", str(tmp_path / "no\x1b[2Jsuch")]) == 5
    shown = capfd.readouterr()
    assert "\x1b" not in shown.out + shown.err
    assert "\r" not in shown.out + shown.err
    assert "\\x1b[31mred" in shown.out
    assert printable_lines("a\nb\x07") == "a\nb\\x07"
    assert printable_lines("3.9\u00a0%") == "3.9 %"
    reasons = ["query", "SELECT status_reason FROM devices", "--results", str(tmp_path / "results"), "--format", "csv"]
    assert call(reasons) == 0
    assert "\x1b[31mred" in capfd.readouterr().out  # a pipe receives what is stored
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    assert call(reasons) == 0
    assert "\x1b" not in capfd.readouterr().out


def test_pages_send_no_form_and_have_no_other_base():
    head = environment().get_template("base.html.j2").render(stylesheet="")
    policy = re.search(r'Content-Security-Policy" content="([^"]+)"', head)
    assert policy is not None
    assert {"default-src 'none'", "form-action 'none'", "base-uri 'none'"} <= set(policy[1].split("; "))


@pytest.mark.parametrize("command", ["check", "identify", "compare", "diagnose"])
@pytest.mark.parametrize("volts", [1e308, 1e160])
def test_numbers_that_no_one_measures_are_refused_without_a_warning(command, volts, tmp_path, capfd):
    t = np.arange(2000) / 10_000.0
    names = ("drive1_V", "drive2_V", "sense1_V", "sense2_V")
    frame = pd.DataFrame({"time_s": t, **{name: np.sin(3000.0 * t) for name in names}})
    frame.loc[100:200, "sense2_V"] = volts
    frame.to_csv(tmp_path / "big.csv", index=False)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert call([command, str(tmp_path / "big.csv")]) == 5
    assert "sense2_V has 101 values beyond any measurement, the first in row 100" in capfd.readouterr().err


def test_records_that_no_device_could_have_made_are_a_failed_fit(tmp_path, capfd):
    t, random = np.arange(20000) / 10_000.0, np.random.default_rng(1)
    noise = random.normal(size=(t.size, 2)) * 1e-9
    drives = {"drive1_V": np.sin(3000.0 * t), "drive2_V": np.cos(3300.0 * t)}
    frame = pd.DataFrame({"time_s": t, **drives, "sense1_V": noise[:, 0], "sense2_V": noise[:, 1]})
    frame.to_csv(tmp_path / "noise.csv", index=False)
    assert call(["refine", str(tmp_path / "noise.csv"), "--json"]) == 1
    assert json.loads(capfd.readouterr().out)["verdict"] == "fit_failed"
