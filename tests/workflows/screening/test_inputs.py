"""A run is bound to its inputs: what is changed after its start neither enters it nor is confused with it."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from pipeline.errors import MeasurementError
from pipeline.experiment.campaign import write_campaign
from pipeline.store.digest import table_digest
from pipeline.store.provenance import provenance
from pipeline.store.read import read_run
from pipeline.store.run import create_run
from pipeline.store.schema import devices_table
from populations.spec import DEFAULT
from tests.drawn_devices import IRREGULARITY, drawn_block
from tests.pipeline.experiment.checks.planted_faults import healthy
from tests.stub_runs import CONFIG, stub_runs
from workflows.cli import call
from workflows.screening.block import BlockTables, DeviceBlock
from workflows.screening.campaign_block import campaign_block
from workflows.screening.virtual_device import _model

Block = Callable[[Any, DeviceBlock], BlockTables]
EFFECT = '''
"""Damping of the user."""
from pipeline.device.effect import Effect
from pipeline.device.parameters import Parameter

def force(t, q, qd, u, p, laws, out):
    for i in range(laws.axes):
        out[i] -= {factor} * p[0] * qd[i]

EFFECT = Effect(
    name="own_damping", law="psi\'\' -= d psi\'", source="a test", signature="broader peaks",
    parameters=(Parameter("d", "1/s", 0.0, 10.0, "own damping", scale=1.0),), force=force, plants=("gyro",),
)
'''


def measured_block(source: Any, at: DeviceBlock) -> BlockTables:
    """The ids and angular gains of measured devices as their campaign.toml states them."""
    read = [one.read() for one in source[1]]
    names = [campaign.device_id for campaign in read]
    columns = {"status": ["ok"] * at.count, "verdict": ["pass"] * at.count, "f1_hz": [c.angular_gain for c in read]}
    return BlockTables(at.index, devices_table({"device_id": names, **columns}), None, {"ok": at.count})


def interrupted_after(blocks: int, block: Block) -> Block:
    def until(source: Any, at: DeviceBlock) -> BlockTables:
        if at.index >= blocks:
            raise KeyboardInterrupt
        return block(source, at)

    return until


def config(folder: Path, text: str) -> list[str]:
    (folder / "night.toml").write_text(CONFIG.format(devices=6) + text, encoding="utf-8")
    return ["run", str(folder / "night.toml"), "--out", str(folder / "results")]


def resumed(folder: Path, *more: str) -> int:
    return call(["run", "--resume", "latest", "--out", str(folder / "results"), *more])


@pytest.fixture
def fab(tmp_path: Path) -> Path:
    """A population of the user, below the folder of the configuration that names it."""
    path = tmp_path / "fab.toml"
    path.write_text(DEFAULT.read_text(encoding="utf-8"), encoding="utf-8")
    return path


def higher(fab: Path) -> None:
    """Rocking frequencies that lie 20 Hz higher."""
    text = fab.read_text(encoding="utf-8")
    assert "rocking_hz = 535.5" in text
    fab.write_text(text.replace("rocking_hz = 535.5", "rocking_hz = 555.5"), encoding="utf-8")


def digest(results: Path) -> str:
    return table_digest(read_run(results).devices)


def test_a_population_that_changes_after_an_interrupt_does_not_enter_the_run(fab, tmp_path, monkeypatch, capfd):
    stub_runs(monkeypatch, drawn_block)
    arguments = config(tmp_path, '[source]\nspec = "fab.toml"\n')
    assert call([*arguments[:-1], str(tmp_path / "whole")]) == 0
    stub_runs(monkeypatch, interrupted_after(1, drawn_block))
    assert call(arguments) == 130
    higher(fab)
    stub_runs(monkeypatch, drawn_block)
    capfd.readouterr()
    assert resumed(tmp_path) == 0
    assert "fab.toml has changed since the run started; the run uses its own copy" in capfd.readouterr().err
    assert digest(tmp_path / "results") == digest(tmp_path / "whole")
    fab.unlink()
    assert call(["report", "--results", str(tmp_path / "results")]) == 0
    assert call(["verify", "--results", str(tmp_path / "results")]) == 0


def test_resume_refuses_what_the_run_was_not_started_with_and_shows_the_difference(fab, tmp_path, monkeypatch, capfd):
    arguments = config(tmp_path, '[source]\nspec = "fab.toml"\n')
    stub_runs(monkeypatch, interrupted_after(1, drawn_block))
    assert call(arguments) == 130
    higher(fab)
    capfd.readouterr()
    assert resumed(tmp_path, arguments[1]) == 2
    assert "population.device.rocking_hz: 535.5 -> 555.5" in capfd.readouterr().err
    assert resumed(tmp_path, "--devices", "24", "--seed", "2") == 2
    assert "run.devices: 6 -> 24; run.seed: 1 -> 2" in capfd.readouterr().err
    config(tmp_path, '[source]\nspec = "fab.toml"\n[limits.split_hz]\nmax = 3.0\n')
    assert resumed(tmp_path, arguments[1]) == 2
    assert "limits.f1_hz.max: 546.21 -> None" in capfd.readouterr().err
    assert read_run(tmp_path / "results").devices.num_rows == 2


def test_resume_with_the_same_inputs_is_accepted(fab, tmp_path, monkeypatch):
    arguments = config(tmp_path, '[source]\nspec = "fab.toml"\n')
    stub_runs(monkeypatch, interrupted_after(1, drawn_block))
    assert call(arguments) == 130
    stub_runs(monkeypatch, drawn_block)
    assert resumed(tmp_path, arguments[1], "--devices", "6") == 0


def test_irregularities_and_effects_of_the_user_are_kept_with_the_run(fab, tmp_path, monkeypatch):
    for name, code in (("mine", IRREGULARITY), ("laws", EFFECT)):
        (tmp_path / name).mkdir()
        (tmp_path / name / "own.py").write_text(code.format(factor=1.0), encoding="utf-8")
    text = (
        'irregularity_folders = ["mine"]\n' + fab.read_text(encoding="utf-8") + "\n[irregularity.own]\ndie_pct = 3.0\n"
    )
    fab.write_text(text, encoding="utf-8")
    arguments = config(tmp_path, '[source]\nspec = "fab.toml"\n[effects.own_damping]\nsize = { d = [1.0, 0.0] }\n')
    night = tmp_path / "night.toml"
    night.write_text('effect_folders = ["laws"]\n' + night.read_text(encoding="utf-8"), encoding="utf-8")
    stub_runs(monkeypatch, drawn_block)
    assert call([*arguments[:-1], str(tmp_path / "whole")]) == 0
    stub_runs(monkeypatch, interrupted_after(1, drawn_block))
    assert call(arguments) == 130
    (tmp_path / "mine" / "own.py").write_text(IRREGULARITY.format(factor=3.0), encoding="utf-8")
    (tmp_path / "laws" / "own.py").unlink()
    stub_runs(monkeypatch, drawn_block)
    assert resumed(tmp_path) == 0
    assert digest(tmp_path / "results") == digest(tmp_path / "whole")


@pytest.fixture
def lot(tmp_path: Path) -> Path:
    """Six measured campaigns, and a configuration of a run on them."""
    for n in range(6):
        made = replace(healthy(), device_id=f"D{n}", angular_gain=0.5 + 0.01 * n)
        write_campaign(made, tmp_path / "lot" / f"device-{n}")
    return tmp_path / "lot"


def test_campaigns_that_change_after_an_interrupt_do_not_enter_the_run(lot, tmp_path, monkeypatch, capfd):
    arguments = config(tmp_path, '[source]\nkind = "campaigns"\npath = "lot"\n')
    stub_runs(monkeypatch, interrupted_after(1, measured_block))
    assert call(arguments) == 130
    # A new folder sorts before the others, and would shift every device of the blocks that are left.
    shutil.copytree(lot / "device-0", lot / "a-new-device")
    declared = lot / "device-4" / "campaign.toml"
    declared.write_text(declared.read_text(encoding="utf-8").replace("0.54", "0.94"), encoding="utf-8")
    stub_runs(monkeypatch, measured_block)
    capfd.readouterr()
    assert resumed(tmp_path) == 0
    assert "device-4/campaign.toml has changed" in capfd.readouterr().err.replace("\\", "/")
    found = read_run(tmp_path / "results").devices
    assert found["device_id"].to_pylist() == [f"D{n}" for n in range(6)]
    assert found["f1_hz"].to_pylist() == pytest.approx([0.5 + 0.01 * n for n in range(6)])


def test_a_record_that_changes_after_an_interrupt_is_named(lot, tmp_path, monkeypatch, capfd):
    arguments = config(tmp_path, '[source]\nkind = "campaigns"\npath = "lot"\n')
    stub_runs(monkeypatch, interrupted_after(1, measured_block))
    assert call(arguments) == 130
    record = next((lot / "device-5").glob("record-2.*"))
    record.write_bytes(record.read_bytes() + b"\0")
    capfd.readouterr()
    assert resumed(tmp_path) == 2
    assert str(record) in capfd.readouterr().err
    assert read_run(tmp_path / "results").devices.num_rows == 2


def test_a_record_that_changes_during_a_night_costs_its_own_row(lot, tmp_path, monkeypatch, capfd):
    def block(source: Any, at: DeviceBlock) -> BlockTables:
        if at.index == 1:
            record = next((lot / "device-3").glob("record-2.*"))
            record.write_bytes(next((lot / "device-3").glob("record-1.*")).read_bytes())
        return campaign_block(source[0], at, source[1])

    read = MeasurementError("this device was read as it should be")
    monkeypatch.setattr("workflows.screening.campaign_block.identify_campaign", raising(read))
    stub_runs(monkeypatch, block)
    assert call(config(tmp_path, '[source]\nkind = "campaigns"\npath = "lot"\n')) == 1
    reasons = read_run(tmp_path / "results").devices["status_reason"].to_pylist()
    assert "record-2.parquet has changed since the run started (sha256 " in reasons.pop(3)
    assert all("as it should be" in reason for reason in reasons)


def raising(error: Exception) -> Callable[..., Any]:
    def function(*_: Any) -> Any:
        raise error

    return function


def test_a_run_of_an_older_version_is_not_resumed_and_the_message_says_why(tmp_path, capfd):
    old = create_run(tmp_path, "20250101T000000000-seed1", "[a_table_of_then]\nkey = 1\n", provenance(1))
    old.commit_block(0, devices_table({"device_id": ["D1"]}), None)
    for more in ([], ["--devices", "7"]):
        assert call(["run", "--resume", "latest", "--out", str(tmp_path), *more]) == 2
        message = capfd.readouterr().err
        assert "by a version of gyroscreen that did not store its inputs" in message
        assert message.count("\n") == 1


def test_every_input_is_listed_with_its_hash(fab, tmp_path, monkeypatch):
    stub_runs(monkeypatch, drawn_block)
    assert call(config(tmp_path, '[source]\nspec = "fab.toml"\n')) == 0
    stored = json.loads(next((tmp_path / "results").glob("run=*/inputs.json")).read_bytes())
    text = fab.read_text(encoding="utf-8")
    digest = hashlib.sha256(text.encode()).hexdigest()
    assert stored["files"] == [{"what": "population", "path": str(fab), "sha256": digest, "bytes": len(text.encode())}]
    assert stored["texts"] == {digest: text}


def test_code_that_changes_during_a_night_does_not_enter_it_nor_its_report(fab, tmp_path, monkeypatch):
    for name, code in (("mine", IRREGULARITY), ("laws", EFFECT)):
        (tmp_path / name).mkdir()
        (tmp_path / name / "own.py").write_text(code.format(factor=1.0), encoding="utf-8")
    fab.write_text(
        'irregularity_folders = ["mine"]\n' + fab.read_text(encoding="utf-8") + "\n[irregularity.own]\ndie_pct = 3.0\n",
        encoding="utf-8",
    )
    arguments = config(tmp_path, '[source]\nspec = "fab.toml"\n[effects.own_damping]\nsize = { d = [1.0, 0.0] }\n')
    night = tmp_path / "night.toml"
    night.write_text('effect_folders = ["laws"]\n' + night.read_text(encoding="utf-8"), encoding="utf-8")
    with monkeypatch.context() as patch:
        stub_runs(patch, drawn_block)
        assert call([*arguments[:-1], str(tmp_path / "whole")]) == 0

    def changed_before_the_last(source: Any, at: DeviceBlock) -> BlockTables:
        """The last block is computed by a worker that starts after the user has changed the code."""
        if at.index == 2:
            (tmp_path / "mine" / "own.py").write_text(IRREGULARITY.format(factor=3.0), encoding="utf-8")
            shutil.rmtree(tmp_path / "laws")
            _model.cache_clear()
        return drawn_block(source, at)

    stub_runs(monkeypatch, changed_before_the_last, page=True)
    assert call(arguments) == 0
    assert digest(tmp_path / "results") == digest(tmp_path / "whole")
    assert "own_damping" in next((tmp_path / "results").glob("run=*/report.html")).read_text(encoding="utf-8")
