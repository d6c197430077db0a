"""The end of a night over measured campaigns: does the lot come from the population for screening, and did it drift?"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from pipeline.store.schema import devices_table
from populations.draw import draw
from populations.spec import load_spec
from tests.stub_runs import stub_runs
from workflows.cli import call
from workflows.lots.simulate import NOISE, measured_values
from workflows.screening import outcome
from workflows.screening.block import BlockTables
from workflows.screening.campaign_block import _stated


class Fab:
    """Nights of campaigns whose estimates are drawn: 3 wafers x 20 dies of one lot."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.values: dict[str, dict[str, float]] = {}

    def lot(self, seed: int, placed: bool = True, **changed: float) -> Path:
        spec = load_spec(None)
        spec = spec.with_values({key.replace("__", "."): value for key, value in changed.items()})
        wafer = msgspec.structs.replace(spec.wafer, lots_per_batch=1, wafers_per_lot=3)
        made = draw(msgspec.structs.replace(spec, wafer=wafer), seed, 0, 60)
        values = measured_values(made, np.random.default_rng(seed))
        root = self.folder / f"lot{seed}"
        for k, (x, y, w) in enumerate(zip(made.die_x_mm, made.die_y_mm, made.wafer)):
            name = f"S{seed}-{k:03d}"
            place = f'lot = "L{seed}"\nwafer = "L{seed}-{w}"\ndie_x_mm = {x}\ndie_y_mm = {y}\n' if placed else ""
            (root / name).mkdir(parents=True)
            (root / name / "campaign.toml").write_text(
                f'[device]\nid = "{name}"\n{place}[[record]]\nfile = "r.csv"\n', encoding="utf-8"
            )
            self.values[name] = {q: float(values[q][k]) for q in NOISE}
        return root

    def block(self, source: Any, at: Any) -> BlockTables:
        _, campaigns = source
        names = [one.device().id for one in campaigns]
        columns = {q: [self.values[name][q] for name in names] for q in NOISE}
        columns |= {f"{q}_sd": [NOISE[q]] * len(names) for q in NOISE}
        devices = devices_table(
            {"device_id": names, "status": ["ok"] * len(names), "verdict": ["pass"] * len(names)}
            | columns
            | _stated(campaigns)
        )
        return BlockTables(at.index, devices, None, {"ok": at.count})

    def night(self, lot: Path, more: str = "", code: int = 0) -> None:
        config = self.folder / f"{lot.name}.toml"
        config.write_text(
            f'[run]\nblock = 60\n[diagnosis]\nenabled = false\n[source]\nkind = "campaigns"\npath = "{lot.name}"\n{more}',
            encoding="utf-8",
        )
        assert call(["run", str(config), "--out", str(self.folder / "results"), "--json"]) == code


@pytest.fixture
def fab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Fab:
    made = Fab(tmp_path)
    stub_runs(monkeypatch, made.block)
    return made


def answer(capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    return found


PAGE = outcome.rendered_report


def test_nights_of_the_population_agree_and_a_changed_one_departs_and_drifts(fab, capsys, monkeypatch):
    fab.night(fab.lot(1))
    first = answer(capsys)["lot_origin"]
    assert (first["origin"]["verdict"], first["origin"]["devices"]) == ("from_population", 60)
    assert first["origin"]["population"] == "cloverleaf"
    assert first["drift"]["verdict"] == "undecided"
    assert "no earlier night" in first["drift"]["reason"]
    fab.night(fab.lot(2))
    second = answer(capsys)["lot_origin"]
    assert second["origin"]["verdict"] == "from_population"
    assert (second["drift"]["verdict"], second["drift"]["earlier_devices"]) == ("no_drift", 60)
    monkeypatch.setattr(outcome, "rendered_report", PAGE)
    # The gain of the pick-offs varies three times as much from die to die as the population says.
    fab.night(fab.lot(3, electrode_area__die_pct=1.2, electrode_gap__die_pct=0.87))
    run = answer(capsys)
    third = run["lot_origin"]
    assert third["origin"]["verdict"] == "departs"
    assert third["origin"]["p_value"] < 1e-3
    named = third["origin"]["departures"][0]
    assert (named["kind"], named["level"]) == ("spread", "device")
    assert any(word in named["part"] for word in ("electrode", "gain"))
    assert third["drift"]["verdict"] == "drifted"
    assert third["drift"]["departures"][0]["quantity"] in (
        "ln_rocking_gain",
        "ln_updown_gain",
        "sense_imbalance",
        "drive_imbalance",
    )
    page = Path(run["report"]).read_text(encoding="utf-8")
    assert "Where this lot comes from" in page
    assert "does not come from the population cloverleaf" in page
    assert "drifted against 2 earlier nights (120 devices)" in page
    monkeypatch.setattr(outcome, "rendered_report", lambda *_, **__: "<!doctype html>")
    assert call(["report", "--results", str(fab.folder / "results"), "--json"]) == 0
    assert answer(capsys)["lot_origin"] == third


def test_campaigns_that_state_no_place_leave_the_questions_undecided(fab, capsys):
    fab.night(fab.lot(1, placed=False))
    found = answer(capsys)["lot_origin"]
    assert [found[one]["verdict"] for one in ("origin", "drift")] == ["undecided", "undecided"]
    assert "0 identified devices state lot, wafer and die_x_mm" in found["origin"]["reason"]
    fab.night(fab.folder / "lot1", "[lot_origin]\nenabled = false\n")
    assert answer(capsys)["lot_origin"] is None


@pytest.mark.parametrize(
    "line", ['population = "nothing.toml"', "false_alarm = 0.0", "nights = -1", 'spec = "cloverleaf"']
)
def test_a_wrong_key_is_found_before_the_first_device(fab, capsys, line):
    fab.lot(1)
    fab.night(fab.folder / "lot1", f"[lot_origin]\n{line}\n", code=2)
    told = capsys.readouterr().err
    assert "Traceback" not in told
    assert len(told.strip().splitlines()) <= 3
