"""The loop on a measured resonator: what it finds by itself, rung by rung, and what a wrong hold looks like."""

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest

from workflows import learning
from workflows.cli import call
from workflows.studies.silverbox import FILE, MODEL, PARTS, RATE_HZ, campaign_of, table

DATA = Path(__file__).resolve().parents[3] / "shared" / "data" / "silverbox"
pytestmark = [
    pytest.mark.silverbox,
    pytest.mark.skipif(not (DATA / FILE).exists(), reason="the Silverbox record is not beside the project"),
]
FIT, HELD = 4096, 6000


def shortened(hold):
    """Beginnings of the multisines, and the end of the arrow, where it is loudest."""
    campaign = campaign_of(DATA, hold)
    records = []
    for record in campaign.records:
        part = slice(-HELD, None) if record.name == "arrow" else slice(0, FIT if record.role == "fit" else HELD)
        records.append(replace(record, drive_v=record.drive_v[part].copy(), sense_v=record.sense_v[part].copy()))
    return replace(campaign, records=tuple(records))


def test_the_loop_climbs_from_a_linear_model_to_a_third_of_a_millivolt():
    rows = table(found := learning.refine(shortened("bandlimited"), MODEL))
    ground, cubic, quadratic = rows[:3]
    assert (cubic["effect"], quadratic["effect"]) == ("cubic_stiffness", "quadratic_stiffness")
    assert ground["test_mv"] > 5.0
    assert ground["arrow_mv"] > 15.0
    assert cubic["test_mv"] < 0.65
    assert quadratic["test_mv"] < 0.35
    assert quadratic["arrow_mv"] < 0.7
    assert all(row["status"] == "confirmed" for row in (cubic, quadratic))
    # Nothing that a wrong hold looks like is needed, so nothing is said against this one.
    assert not {"resistive_feedthrough", "loop_delay", "pickoff_pole"} & set(found.effects)
    assert found.to_dict()["hints"] == []
    assert all(row["test_mv"] <= before["test_mv"] for before, row in pairwise(rows))


@pytest.mark.parametrize("hold", ["foh", "zoh"])
def test_a_wrong_hold_is_told_from_missing_physics(hold, tmp_path, capfd):
    entries = [
        f"[[record]]\nfile = {json.dumps(str(DATA / FILE))}\nname = '{name}'\nrole = '{role}'\nat_rest = false\n"
        f"start = {start}\nstop = {start + FIT if role == 'fit' else start + HELD if name == 'test' else stop}\n"
        for name, role, start, stop in PARTS
        if name != "arrow"
    ]
    head = f"[instrument]\nsample_rate_hz = {RATE_HZ}\nhold = '{hold}'\nbias_v = 0.0\n"
    (tmp_path / "campaign.toml").write_text(head + '[columns]\ndrive1_V = "V1"\nsense1_V = "V2"\n' + "".join(entries))
    (tmp_path / "model.toml").write_text('plant = { kind = "modal", modes = 1, sense = "displacement" }\n')
    assert call(["refine", str(tmp_path), "--model", str(tmp_path / "model.toml"), "--json"]) == 0
    said = json.loads(capfd.readouterr().out)
    ground, first, last = said["ladder"][0], said["ladder"][1], said["ladder"][-1]
    assert first["effect"] == "cubic_stiffness"
    assert 'hold = "bandlimited" explains the records better' in said["hints"][0]
    # No noise level is known: no error in sigmas, but relative ones and volts for every record.
    for rung in said["ladder"]:
        assert rung["error_fit"] is rung["error_validate"] is rung["misfit_fit"] is None
        assert set(rung["error_v"]) == {"train", "test"}
        assert 0.0 < rung["relative_error"] < 1.0
    assert said["noise"]["from"] == "residual"
    if hold == "zoh":
        assert said["verdict"] == "unknown"
        assert {rung["status"] for rung in said["ladder"][1:]} == {"partial"}
        assert last["error_v"]["test"] > 10e-3
    else:
        assert {"quadratic_stiffness", "resistive_feedthrough"} <= set(said["effects"])
        assert last["error_v"]["test"] < 0.4e-3 < 5e-3 < ground["error_v"]["test"]
