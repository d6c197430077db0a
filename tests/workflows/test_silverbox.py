"""The learning loop on a measured resonator: the rungs of its ladder, and the hint that a wrong hold gives."""

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
FIT, HELD, LOUD = 2048, 4096, 1024


def shortened(hold):
    """The start of the multisines, and the end of the arrow, where its level is highest."""
    campaign = campaign_of(DATA, hold)
    records = []
    for record in campaign.records:
        part = slice(-HELD, None) if record.name == "arrow" else slice(0, FIT if record.role == "fit" else HELD)
        records.append(replace(record, drive_v=record.drive_v[part].copy(), sense_v=record.sense_v[part].copy()))
    return replace(campaign, records=tuple(records))


def test_refine_adds_cubic_then_quadratic_stiffness_and_the_test_error_falls_below_0_35_mv():
    rows = table(found := learning.refine(shortened("bandlimited"), MODEL))
    first, cubic, quadratic = rows[:3]
    assert (cubic["effect"], quadratic["effect"]) == ("cubic_stiffness", "quadratic_stiffness")
    assert first["test_mv"] > 5.0
    assert first["arrow_mv"] > 15.0
    assert cubic["test_mv"] < 0.65
    assert quadratic["test_mv"] < 0.35
    assert quadratic["arrow_mv"] < 0.7
    assert all(row["status"] == "confirmed" for row in (cubic, quadratic))
    # No effect that imitates a wrong hold is added, so there is no hint.
    assert not {"resistive_feedthrough", "loop_delay", "pickoff_pole"} & set(found.effects)
    assert found.answer.hints == ()
    assert all(row["test_mv"] <= before["test_mv"] for before, row in pairwise(rows))


@pytest.mark.parametrize("hold", ["foh", "zoh"])
def test_a_wrongly_declared_hold_gives_a_hint_that_names_the_better_hold(hold, tmp_path, capfd):
    entries = [
        f"[[record]]\nfile = {json.dumps(str(DATA / FILE))}\nname = '{name}'\nrole = '{role}'\nat_rest = false\n"
        f"start = {start}\nstop = {start + FIT if role == 'fit' else start + HELD if name == 'test' else stop}\n"
        for name, role, start, stop in PARTS
        if name != "arrow"
    ]
    head = f"[instrument]\nsample_rate_hz = {RATE_HZ}\nhold = '{hold}'\nbias_v = 0.0\n"
    (tmp_path / "campaign.toml").write_text(head + '[columns]\ndrive1_V = "V1"\nsense1_V = "V2"\n' + "".join(entries))
    (tmp_path / "model.toml").write_text('plant = { kind = "modal", modes = 1, sense = "displacement" }\n')
    assert call(["refine", str(tmp_path), "--model", str(tmp_path / "model.toml"), "--json"]) == (
        1 if hold == "zoh" else 0
    )
    answer = json.loads(capfd.readouterr().out)
    given, cubic, last = answer["ladder"][0], answer["ladder"][1], answer["ladder"][-1]
    assert cubic["effect"] == "cubic_stiffness"
    assert 'hold = "bandlimited" explains the records better' in answer["hints"][0]
    # The noise level is unknown: no error in sigmas, but relative errors and volts for every record.
    for rung in answer["ladder"]:
        assert rung["error_fit"] is rung["error_validate"] is rung["misfit_fit"] is None
        assert set(rung["error_v"]) == {"train", "test"}
        assert 0.0 < rung["relative_error"] < 1.0
    assert answer["noise"]["from"] == "residual"
    if hold == "zoh":
        assert answer["verdict"] == "unknown"
        assert {rung["status"] for rung in answer["ladder"][1:]} == {"partial"}
        assert last["error_v"]["test"] > 10e-3
    else:
        assert {"quadratic_stiffness", "resistive_feedthrough"} <= set(answer["effects"])
        assert last["error_v"]["test"] < 0.4e-3 < 5e-3 < given["error_v"]["test"]


def test_a_loud_record_gives_the_ladder_and_compare_reproduces_its_first_and_last_addition():
    """The end of the arrow is fitted, its middle and start are held out: 150, 90 and 23 mV of drive."""
    whole = campaign_of(DATA, "bandlimited").records[2]

    def part(name, role, first):
        rows = slice(first - PARTS[2][2], first - PARTS[2][2] + LOUD)
        return replace(whole, name=name, role=role, drive_v=whole.drive_v[rows], sense_v=whole.sense_v[rows])

    records = (part("loud", "fit", 40_000 - LOUD), part("medium", "validate", 20_000), part("faint", "validate", 1_500))
    campaign = replace(campaign_of(DATA, "bandlimited"), records=records)
    ladder = learning.refine(campaign, MODEL).answer.ladder
    assert [rung.effect for rung in ladder[:3]] == [None, "cubic_stiffness", "quadratic_stiffness"]
    assert [rung.status for rung in ladder[1:3]] == ["confirmed", "confirmed"]
    model = MODEL.with_channels(1, 1)
    for rung in ladder:
        model = model if rung.effect is None else model.with_effect(rung.effect)
        if rung not in (ladder[1], ladder[-1]):
            continue
        alone = learning.compare(campaign, model).answer
        assert alone.fit_ok
        assert alone.relative_error["fit"] == pytest.approx(rung.relative_error, rel=1e-3)
