"""gyroscreen run --dry-run: population, limits with their origin, nominal device, expected yield; nothing is run."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest

from populations.draw import draw
from populations.spec import load_spec
from reports.clusters import clustering
from reports.decision import conforms
from reports.limits import DEFAULT_FILE, DEFAULT_LIMITS
from tests.drawn_devices import IRREGULARITY
from workflows.cli import call
from workflows.config import load_config
from workflows.screening.block import true_quantities
from workflows.screening.preview import PLAIN_DEVICES, preview


def dry(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict:
    assert call(["run", *arguments, "--dry-run", "--json"]) == 0
    found: dict = json.loads(capsys.readouterr().out)
    return found


def test_the_text_is_a_configuration_with_comments(tmp_path, capsys):
    assert call(["run", "--dry-run"]) == 0
    text = capsys.readouterr().out
    assert tomllib.loads(text)["limits"]["split_hz"] == {"max": 3.0}
    (tmp_path / "again.toml").write_text(text, encoding="utf-8")
    assert load_config(tmp_path / "again.toml").judged_by() == DEFAULT_LIMITS
    for said in (
        "# population: cloverleaf",
        "# limits: shipped default, limits_default.toml",
        "rocking 535.5",
        "expected yield",
    ):
        assert said in text
    assert text.isascii() or "\u00a0" not in text


def test_the_expected_yield_is_that_of_many_lots(capsys):
    """An independent estimate: the devices of 300 lots as a run draws them, lots as draws."""
    implied = dry(capsys)["implied"]
    spec, config = load_spec(), load_config(None)
    lots, passed = [], []
    for seed in range(60):
        drawn = draw(spec, 1000 + seed, 0, 20)
        true = true_quantities(config, drawn.true, spec.angular_gain)
        passed += np.where(conforms(DEFAULT_LIMITS, true), "pass", "fail").tolist()
        lots += [f"{seed}/{lot}" for lot in drawn.lot]
    found = clustering(passed, lots, "lot", level=0.997).interval
    assert found is not None
    low, high = implied["interval"]["low"], implied["interval"]["high"]
    assert found.low <= high
    assert low <= found.high
    assert high - low < 0.04
    assert implied["share"] == preview(config).share, "the draw is not repeatable"


def test_the_nominal_device_is_that_of_the_file(tmp_path, capsys):
    (tmp_path / "fast.toml").write_text('extends = "cloverleaf"\n[device]\nrocking_hz = 560.0\n', encoding="utf-8")
    (tmp_path / "night.toml").write_text('[source]\nspec = "fast.toml"\n', encoding="utf-8")
    found = dry(capsys, str(tmp_path / "night.toml"))
    assert found["population"] == "cloverleaf"
    assert found["implied"]["nominal"]["f1_hz"] == pytest.approx(560.0, rel=1e-12)
    assert found["implied"]["share"] < 0.1, "the limits of the shipped device admit frequencies up to 546 Hz"


def test_limits_name_the_file_that_states_them(tmp_path, capsys):
    assert dry(capsys)["limits"]["file"] == DEFAULT_FILE.name
    night = tmp_path / "night.toml"
    night.write_text("[limits.split_hz]\nmax = 2.0\n", encoding="utf-8")
    found = dry(capsys, str(night))
    assert found["limits"]["from"] == "file"
    assert found["limits"]["file"] == str(night)
    assert len(found["limits"]["sha256"]) == 64
    assert set(found["config"]["limits"]) == {"split_hz"}
    loss = found["implied"]["quantities"]["split_hz"]["share"]
    assert loss == pytest.approx(1.0 - found["implied"]["share"])


def test_a_limit_on_theta_counts_although_an_axis_has_no_quantiles(tmp_path, capsys):
    night = tmp_path / "night.toml"
    night.write_text("[limits.theta_deg]\nmin = 0.0\nmax = 90.0\n", encoding="utf-8")
    found = dry(capsys, str(night))["implied"]
    assert found["quantities"]["theta_deg"]["quantiles"] == [None, None, None]
    assert 0.4 < found["share"] < 0.6


def test_measured_campaigns_have_no_quick_draw(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert call(["simulate", "lot/A1"]) == 0
    Path("night.toml").write_text('[source]\nkind = "campaigns"\npath = "lot"\n', encoding="utf-8")
    capsys.readouterr()
    found = dry(capsys, "night.toml")
    assert found["implied"] is None
    assert found["limits"]["from"] == "shipped default"


def test_an_irregularity_without_latent_normals_is_drawn_as_the_run_does(tmp_path, capsys):
    (tmp_path / "mine").mkdir()
    unsteady = IRREGULARITY.format(factor=1.0).replace(
        "return Change", 'site.normal("die", 1 if len(site.index) == 1 else 2, "more")\n    return Change'
    )
    (tmp_path / "mine" / "own.py").write_text(unsteady, encoding="utf-8")
    (tmp_path / "own.toml").write_text(
        'extends = "cloverleaf"\nirregularity_folders = ["mine"]\n[irregularity.own]\ndie_pct = 0.1\n', encoding="utf-8"
    )
    (tmp_path / "night.toml").write_text('[source]\nspec = "own.toml"\n', encoding="utf-8")
    found = dry(capsys, str(tmp_path / "night.toml"))["implied"]
    assert (found["drawn"], found["lots"]) == (PLAIN_DEVICES, 5)
    assert found["interval"]["low"] < found["share"] < found["interval"]["high"]


def test_a_population_with_an_impossible_device_is_one_error(tmp_path, capsys):
    (tmp_path / "soft.toml").write_text(
        'extends = "cloverleaf"\n[irregularity.residual_anisotropy]\ndie_pct = 10.0\nlot_ratio = 10.0\n',
        encoding="utf-8",
    )
    (tmp_path / "night.toml").write_text('[source]\nspec = "soft.toml"\n', encoding="utf-8")
    assert call(["run", str(tmp_path / "night.toml"), "--dry-run"]) == 2
    message = capsys.readouterr().err
    assert "without a positive stiffness" in message
    assert message.count("\n") == 1
