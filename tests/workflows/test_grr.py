"""gyroscreen grr: a night of repeated campaigns, and wrong input."""

from __future__ import annotations

import json

import numpy as np
import pytest
import tomli_w

from pipeline.experiment.campaign import write_campaign
from pipeline.store.query import query
from pipeline.store.run import create_run
from pipeline.store.schema import devices_table
from tests.stub_runs import empty_pages
from workflows.cli import call
from workflows.config import load_config, to_toml_table
from workflows.screening.plan import without_none
from workflows.simulate import campaign_config, simulate


def stored(folder, columns):
    toml = tomli_w.dumps(without_none(to_toml_table(load_config(None))))
    store = create_run(folder, "r", toml, {})
    store.commit_block(0, devices_table(columns), None)
    store.finish("complete", {})
    return folder


@pytest.fixture
def night(tmp_path):
    """Four parts, two testers, two sessions each, three repeats; sd of split 0.1, tester 0.02, repeatability 0.005 Hz."""
    random = np.random.default_rng(1)
    part, tester, session, repeat = (
        a.ravel() for a in np.meshgrid(range(4), range(2), range(2), range(3), indexing="ij")
    )
    split = 2.0 + (0.1 * random.normal(size=4))[part] + (0.02 * random.normal(size=2))[tester]
    theta = (20.0 * random.normal(size=4))[part] + 0.01 * random.normal(size=part.size)
    return stored(
        tmp_path / "results",
        {
            "device_id": [f"A{p}-T{t}-{s}-{r}" for p, t, s, r in zip(part, tester, session, repeat)],
            "part": [f"A{p}" for p in part],
            "tester": [f"T{t}" for t in tester],
            "session": [f"day {s}" for s in session],
            "status": ["ok"] * part.size,
            "split_hz": split + 0.005 * random.normal(size=part.size),
            "theta_deg": theta,
        },
    )


def test_the_command_prints_studies_of_theta_and_split(night, capfd):
    assert call(["grr", "--results", str(night), "--json"]) == 0
    answer = json.loads(capfd.readouterr().out)
    assert answer["limits"]["from"] == "shipped default"
    studies = {one["quantity"]: one for one in answer["studies"]}
    assert set(studies) == {"theta_deg", "split_hz"}
    split = studies["split_hz"]
    assert (split["measurements"], split["parts"], split["testers"], split["sessions"]) == (48, 4, 2, 4)
    sd = {one["name"]: one["sd"] for one in split["components"]}
    assert sd["repeatability"]["low"] < 0.005 < sd["repeatability"]["high"]
    # The shipped limit of the split is one end, 3 Hz: 3 sd of 3 - 2 Hz.
    (grr,) = (one for one in split["components"] if one["name"] == "GRR")
    assert grr["tolerance"]["value"] == pytest.approx(300 * grr["sd"]["value"] / (3.0 - split["mean"]))
    assert call(["grr", "--results", str(night)]) == 0
    shown = capfd.readouterr().out
    assert "48 measurements of 4 parts, 2 testers, 4 sessions" in shown
    page = night / "run=r" / "grr.html"
    assert shown.splitlines()[-1] == answer["page"] == str(page)
    assert "48 measurements of 4 parts by 2 testers in 4 sessions" in page.read_text()
    assert call(["verify", "--results", str(night)]) == 0  # the page is part of the run


def test_own_limits_give_the_tolerance(night, tmp_path, capfd):
    (tmp_path / "own.toml").write_text("[limits.split_hz]\nmin = 1.0\nmax = 3.0\n")
    page = tmp_path / "pages" / "own.html"
    options = ["--limits", str(tmp_path / "own.toml"), "--out", str(page), "--json"]
    assert call(["grr", "--results", str(night), *options]) == 0
    assert f"--limits {tmp_path / 'own.toml'} (sha256 " in page.read_text()
    assert not (night / "run=r" / "grr.html").exists()
    (split,) = (s for s in json.loads(capfd.readouterr().out)["studies"] if s["quantity"] == "split_hz")
    (grr,) = (one for one in split["components"] if one["name"] == "GRR")
    assert grr["tolerance"]["value"] == pytest.approx(100 * 6 * grr["sd"]["value"] / 2.0)


def test_a_page_that_cannot_be_written_is_one_message(night, tmp_path, capfd):
    (tmp_path / "file").write_text("not a folder")
    assert call(["grr", "--results", str(night), "--out", str(tmp_path / "file" / "page.html")]) == 2
    shown = capfd.readouterr().err
    assert "the page cannot be written" in shown
    assert shown.count("\n") == 1


@pytest.mark.parametrize(
    ("columns", "options", "message"),
    [
        ({"device_id": ["A"], "status": ["ok"], "split_hz": [1.0]}, [], "no campaign of the run names its part"),
        ({"device_id": ["A"], "part": ["P"], "status": ["ok"], "theta_deg": [1.0]}, [], "measured more than once"),
        ({"device_id": ["A", "B"], "part": ["P", "P"], "status": ["misfit"] * 2}, [], "measured more than once"),
        ({"device_id": []}, [], "no campaign of the run names its part"),
        ({"device_id": ["A"], "part": ["P"]}, ["--limits", "missing.toml"], "missing.toml"),
        ({"device_id": ["A"], "part": ["P"]}, ["nosuchrun"], "there is no such run"),
    ],
)
def test_wrong_input_is_one_message(tmp_path, capfd, columns, options, message):
    assert call(["grr", "--results", str(stored(tmp_path / "results", columns)), *options]) == 2
    shown = capfd.readouterr().err
    assert message in shown
    assert shown.count("\n") == 1


def test_campaigns_name_part_tester_and_session(tmp_path, capfd, monkeypatch):
    empty_pages(monkeypatch)
    config = campaign_config(None)
    for k, (tester, session) in enumerate((("T1", "am"), ("T2", "pm"))):
        folder = tmp_path / "campaigns" / f"c{k}"
        write_campaign(simulate(config, {"split_hz": 1.5}, [], k).campaign, folder)
        text = (folder / "campaign.toml").read_text().replace('id = "', f'id = "c{k}-', 1)
        (folder / "campaign.toml").write_text(
            f'{text}\n[conditions]\npart = "A17"\ntester = "{tester}"\nsession = "{session}"\n'
        )
    (tmp_path / "night.toml").write_text(
        '[source]\nkind = "campaigns"\npath = "campaigns"\n[diagnosis]\nenabled = false\n'
    )
    assert call(["run", str(tmp_path / "night.toml"), "--out", str(tmp_path / "results"), "--workers", "1"]) == 0
    found = query("SELECT part, tester, session FROM devices ORDER BY device_id", tmp_path / "results")
    assert found.to_pydict() == {"part": ["A17"] * 2, "tester": ["T1", "T2"], "session": ["am", "pm"]}
    capfd.readouterr()
    # One part says nothing about the spread of parts.
    assert call(["grr", "--results", str(tmp_path / "results")]) == 2
    assert "2 measurements of 1 parts" in capfd.readouterr().err
