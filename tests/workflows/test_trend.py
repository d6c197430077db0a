"""gyroscreen report --against: nights of a results folder, alarms, exit codes, and what may not be compared."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.errors import ConfigError, UsageError
from pipeline.experiment.campaign import write_campaign
from pipeline.store.schema import devices_table
from populations.draw import draw
from reports.decision import conforms
from tests.pipeline.experiment.checks.planted_faults import healthy
from tests.stub_runs import stub_runs
from workflows.cli import call
from workflows.config import RunConfig, load_config
from workflows.config_tables import TrendTable
from workflows.screening.block import BlockTables, DeviceBlock, true_quantities
from workflows.screening.settings import population
from workflows.trend.alarms import given
from workflows.trend.answer import trend

COLUMNS = ("theta_deg", "split_hz", "f1_hz", "f2_hz", "quality1", "quality2", "quadrature_rate_dps", "rate_bias_dps")


def true_block(source: Any, at: DeviceBlock) -> BlockTables:
    """Devices with their true values in the place of estimates, judged by the limits of the run."""
    config: RunConfig = source[0]
    drawn = draw(population(config), config.run.seed, at.first, at.count)
    true = true_quantities(config, drawn.true, population(config).angular_gain)
    passed = conforms(config.judged_by(), true)
    columns = {
        "device_id": list(drawn.device_id),
        "lot": list(drawn.lot),
        "wafer": list(drawn.wafer),
        "status": ["ok"] * at.count,
        "verdict": ["pass" if one else "fail" for one in passed],
        **{name: true[name] for name in COLUMNS},
    }
    return BlockTables(at.index, devices_table(columns), None, {"ok": at.count})


def failed_block(source: Any, at: DeviceBlock) -> BlockTables:
    table = devices_table(
        {
            "device_id": [f"D{at.first + k:06d}" for k in range(at.count)],
            "status": ["fit_failed"] * at.count,
            "verdict": ["undecided"] * at.count,
        }
    )
    return BlockTables(at.index, table, None, {"fit_failed": at.count})


class Fab:
    """A results folder, and nights in it."""

    def __init__(self, folder: Path, patch: pytest.MonkeyPatch) -> None:
        self.folder, self.patch, self.results = folder, patch, folder / "results"

    def night(self, seed: int, text: str = "", devices: int = 40, block: Any = true_block, code: int = 0) -> str:
        """A run with this seed; its id."""
        stub_runs(self.patch, block)
        config = self.folder / f"night{seed}.toml"
        config.write_text(
            f"[run]\ndevices = {devices}\nblock = {devices}\nseed = {seed}\n[diagnosis]\nenabled = false\n{text}"
        )
        assert call(["run", str(config), "--out", str(self.results)]) == code
        return max(path.name for path in self.results.glob("run=*")).removeprefix("run=")

    def report(self, *arguments: str) -> int:
        return call(["report", "--results", str(self.results), *arguments])


@pytest.fixture
def fab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Fab:
    return Fab(tmp_path, monkeypatch)


LOW_Q = '[source]\nspec = "lowq.toml"\n'


def low_q(fab: Fab) -> str:
    (fab.folder / "lowq.toml").write_text('extends = "cloverleaf"\n[operating]\nlid_pressure_pa = 250.0\n')
    return LOW_Q


def json_of(fab: Fab, capfd: pytest.CaptureFixture[str], *arguments: str, code: int = 0) -> dict[str, Any]:
    capfd.readouterr()
    assert fab.report(*arguments, "--json") == code
    found: dict[str, Any] = json.loads(capfd.readouterr().out)
    return found


def test_a_process_that_moved_alarms_and_the_change_is_named(fab, capfd):
    nights = [fab.night(seed) for seed in range(1, 8)]
    moved = fab.night(8, low_q(fab))
    found = json_of(fab, capfd, "--against", "last:10")
    assert found["run_id"] == moved
    assert found["nights"] == [*nights, moved]
    assert {"quality1", "quality2"} & {alarm["name"] for alarm in found["alarms"]}
    assert found["comparison"]["before"] == nights[-1]
    assert {row["name"] for row in found["comparison"]["differences"] if row["differs"]} >= {"quality1", "quality2"}
    changed = {(one["what"], one["key"]): (one["before"], one["after"]) for one in found["changes"]}
    assert changed["population", "population.operating.lid_pressure_pa"] == ("25.0", "250.0")
    assert ("file", "population lowq.toml") in changed
    assert ("configuration", "run.seed") in changed
    assert not [key for what, key in changed if what == "limits"]


def test_alarms_set_the_exit_code_where_the_user_wishes(fab, capfd):
    for seed in range(1, 8):
        fab.night(seed)
    fab.night(8, f"[trend]\nfalse_alarm = 0.01\n{low_q(fab)}")
    assert fab.report("--against", "last:10") == 1
    message = capfd.readouterr().err
    said = [line for line in message.splitlines() if not line.startswith(("identifying", "warning"))]
    assert said[-1].startswith("error: alarm: ")
    assert message.count("error") == 1
    earlier = sorted(path.name for path in fab.results.glob("run=*"))[-2].removeprefix("run=")
    assert fab.report(earlier, "--against", "last:10") == 0
    assert fab.report(earlier, "--against", "last:10", "--alarm", "yield.min=0.99") == 1
    assert fab.report(earlier, "--against", "last:10", "--alarm", "f1_hz.max=600", "--alarm", "f1_hz.min=400") == 0


def test_the_page_stands_beside_the_report_and_the_results_stay_verified(fab, tmp_path):
    run = [fab.night(seed) for seed in (1, 2, 3)][-1]
    folder = fab.results / f"run={run}"
    before = (folder / "report.html").read_bytes()
    assert fab.report("--against", "last:5") == 0
    assert (folder / "trend.html").read_text(encoding="utf-8").startswith("<!DOCTYPE html>")
    assert (folder / "report.html").read_bytes() == before
    assert call(["verify", "--results", str(fab.results)]) == 0
    listed = sorted(path.name for path in folder.iterdir())
    assert fab.report("--against", "last:5", "--out", str(tmp_path / "pages" / "night.html")) == 0
    assert (tmp_path / "pages" / "night.html").exists()
    assert sorted(path.name for path in folder.iterdir()) == listed
    assert fab.report("--against", "last:5", "--out", str(folder)) == 2


def test_the_same_devices_under_other_limits_are_compared_one_by_one(fab, capfd):
    first = fab.night(1)
    fab.night(1, "[limits.split_hz]\nmax = 1.0\n")
    found = json_of(fab, capfd, "--against", first)
    assert found["comparison"]["paired"]
    rows = {row["name"]: row for row in found["comparison"]["differences"]}
    assert rows["split_hz"]["difference"] == 0.0
    assert rows["yield"]["after"] < rows["yield"]["before"]
    assert ("limits", "limits.split_hz.max") in {(one["what"], one["key"]) for one in found["changes"]}
    assert found["charts"] == []


def test_nights_that_cannot_be_compared_are_left_out_with_the_reason(fab, capfd):
    (fab.folder / "fast.toml").write_text('extends = "cloverleaf"\n[device]\nrocking_hz = 540.0\n')
    fab.night(1, '[source]\nspec = "fast.toml"\n')
    fab.night(2, devices=10)
    fab.night(3, block=failed_block, code=1)
    twin = fab.night(4)
    fab.night(5, "[limits.split_hz]\nmax = 1.0\n")

    def stopped(source, at):
        raise KeyboardInterrupt

    fab.night(6, block=stopped, code=130)
    kept = [fab.night(seed) for seed in (7, 8, 9)]
    tonight = fab.night(4)
    found = json_of(fab, capfd, "--against", "last:20", "--leave-out", kept[1])
    reasons = {one["run_id"].rpartition("-")[2]: (one["reason"], one["charts"]) for one in found["left_out"]}
    assert reasons["seed1"][0] == "another device: rocking_hz = 540.0"
    assert "10 devices, not between half and twice the 40" in reasons["seed2"][0]
    assert reasons["seed3"][0] == "no device could be identified"
    assert "the same random numbers" in reasons[twin.rpartition("-")[2]][0]
    assert reasons["seed5"] == ("judged by other limits", ["yield"])
    assert reasons["seed6"][0] == "not complete"
    assert reasons["seed8"][0] == "named by --leave-out"
    assert [name.rpartition("-")[2] for name in found["nights"]] == ["seed5", "seed7", "seed9", "seed4"]
    charts = {chart["name"]: len(chart["points"]) for chart in found["charts"]}
    assert (charts["yield"], charts["f1_hz"]) == (3, 4)
    assert found["run_id"] == tonight


def test_a_first_night_has_nothing_to_compare_with_and_says_so(fab, capfd):
    fab.night(1)
    found = json_of(fab, capfd, "--against", "last:10")
    assert (found["headline"], found["comparison"], found["alarms"]) == ("Too few nights to judge", None, [])


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--against", "last:0"], "names no number of nights"),
        (["--against", "last:many"], "last:1 to last:1000"),
        (["--against", "no-such-run"], "there is no such run"),
        (["--against", "latest"], "names the run itself"),
        (["no-such-run", "--against", "last:3"], "there is no such run"),
        (["--against", "last:3", "--alarm", "yield"], "is not KEY=NUMBER"),
        (["--against", "last:3", "--alarm", "yield.min=low"], "is not KEY=NUMBER"),
        (["--against", "last:3", "--alarm", "yield.least=0.5"], "is not KEY=NUMBER"),
        (["--against", "last:3", "--alarm", "yeild.min=0.5"], "did you mean yield?"),
        (["--against", "last:3", "--alarm", "theta_deg.min=0.5"], "unknown quantity"),
        (["--against", "last:3", "--alarm", "false_alarm=2"], "false_alarm is not valid"),
        (["--against", "last:3", "--alarm", "f1_hz.min=nan"], "not finite"),
        (["--against", "last:3", "--alarm", "f1_hz.min=3", "--alarm", "f1_hz.max=2"], "crossed"),
        (["--against", "last:3", "--leave-out", "gone"], "--leave-out names no earlier run"),
        (["--alarm", "yield.min=0.5"], "--alarm belongs to --against"),
    ],
)
def test_wrong_arguments_are_one_line_with_exit_code_2(fab, capfd, arguments, says):
    fab.night(1, devices=4)
    capfd.readouterr()
    assert fab.report(*arguments) == 2
    message = capfd.readouterr().err
    assert says in message
    assert message.count("\n") == 1


def test_a_folder_without_runs_and_a_run_without_devices_are_one_line(fab, capfd):
    assert fab.report("--against", "last:3") == 2
    assert "the results folder holds no runs" in capfd.readouterr().err

    def stopped(source, at):
        raise KeyboardInterrupt

    fab.night(1, block=stopped, code=130)
    capfd.readouterr()
    assert fab.report("--against", "last:3") == 2
    assert "the run has no devices" in capfd.readouterr().err


def test_a_night_without_an_identified_device_is_one_line(fab, capfd):
    good = fab.night(1)
    bad = fab.night(2, block=failed_block, code=1)
    for arguments in ((bad, "--against", "last:3"), (bad, "--against", good), (good, "--against", bad)):
        capfd.readouterr()
        assert fab.report(*arguments) == 2
        message = capfd.readouterr().err
        assert "no device of the run could be identified" in message
        assert message.count("\n") == 1


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[trend]\nfalse_alarm = 0.0\n", "trend.false_alarm is not valid"),
        ("[trend.limits.yeild]\nmin = 0.5\n", "did you mean yield?"),
        ("[trend.limits.yield]\n", "limits nothing"),
        ("[trend]\nfalse_alarms = 0.01\n", "unknown key in trend"),
    ],
)
def test_wrong_alarms_of_a_configuration_are_found_before_the_run(fab, tmp_path, capfd, text, says):
    path = tmp_path / "night.toml"
    path.write_text(text, encoding="utf-8")
    assert call(["run", str(path), "--out", str(fab.results)]) == 2
    assert says in capfd.readouterr().err
    assert not fab.results.exists()


def test_alarms_of_the_command_line_replace_those_of_the_configuration_key_by_key():
    table = load_config(None).trend
    assert table == TrendTable()
    once = given(table, ["yield.min=0.5", "false_alarm=0.02"])
    twice = given(once, ["yield.max=0.9", "false_alarm=0.01"])
    assert twice.false_alarm == 0.01
    assert (twice.limits["yield"].min, twice.limits["yield"].max) == (0.5, 0.9)
    assert once.limits["yield"].max is None
    with pytest.raises(UsageError):
        given(table, ["=3"])
    with pytest.raises(ConfigError):
        given(table, ["yield.min=inf"])


def test_quantities_with_missing_values_are_charted_where_they_are_known(fab, capfd):
    def blind(source, at):
        tables = true_block(source, at)
        columns = {name: values for name, values in tables.devices.to_pydict().items() if None not in values}
        columns["quality1"] = np.full(at.count, np.nan)
        return BlockTables(at.index, devices_table(columns), None, {"ok": at.count})

    for seed in (1, 2, 3):
        fab.night(seed)
    fab.night(4, block=blind)
    found = trend(fab.results, None, "last:5")
    chart = next(one for one in found.charts if one.name == "quality1")
    assert len(chart.points) == 3
    assert not [alarm for alarm in found.alarms if alarm.name == "quality1"]
    assert fab.report("--against", "last:5") == 0
    assert "quality" in capfd.readouterr().out


def test_measured_lots_are_compared_and_a_lot_that_was_tested_again_counts_once(fab, capfd):
    def measured(source, at):
        names = [campaign.read().device_id for campaign in source[1]]
        f1 = [530.0 + int(name[1:]) for name in names]
        columns = {"device_id": names, "status": ["ok"] * at.count, "verdict": ["pass"] * at.count, "f1_hz": f1}
        return BlockTables(at.index, devices_table(columns), None, {"ok": at.count})

    for lot in "AB":
        for k in range(3):
            write_campaign(replace(healthy(), device_id=f"{lot}{k}"), fab.folder / f"lot{lot}" / f"{lot}{k}")
    runs = []
    for lot in "ABA":
        text = f'[source]\nkind = "campaigns"\npath = "lot{lot}"\n[limits.f1_hz]\nmin = 500.0\n'
        runs.append(fab.night(1, text, block=measured))
    found = json_of(fab, capfd, "--against", "last:5")
    assert [one["run_id"] for one in found["left_out"]] == [runs[0]]
    assert found["left_out"][0]["reason"] == "the same devices as a later night"
    assert not found["comparison"]["paired"]
    assert found["comparison"]["by"] == "device"
    again = json_of(fab, capfd, "--against", runs[0])
    assert again["comparison"]["paired"]
    assert ("population", "source.path") in {(one["what"], one["key"]) for one in found["changes"]}
    fab.night(2)
    virtual = json_of(fab, capfd, "--against", "last:5")
    assert {one["reason"] for one in virtual["left_out"]} == {"devices from campaigns, not from population"}
