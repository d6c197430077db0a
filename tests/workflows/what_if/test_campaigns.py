"""A night of measured campaigns judged again: biases follow from what the campaigns declare, where they declare the same."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.experiment.campaign import write_campaign
from pipeline.store.columns import StoredRun, with_run
from pipeline.store.read import list_runs
from reports.devices import Devices
from tests.pipeline.experiment.checks.planted_faults import healthy
from tests.stub_runs import run_arguments, stub_runs
from workflows.cli import call
from workflows.screening.block import BlockTables, DeviceBlock
from workflows.screening.campaign_block import campaign_block

CHAINS = "[posterior]\nwalkers = 24\nsteps = 4\nrhat_max = 2.0\ness_min = 10.0\nstored_draws = 4000\n"
OLD = "[limits.split_hz]\nmax = 3.0\n[limits.rate_bias_dps]\nmin = -100.0\nmax = 100.0\n"
#: One end lies at the estimate of the device, so that P(conform) is about one half.
NEW = "[limits.split_hz]\nmax = 2.5\n[limits.quadrature_bias_dps]\nmin = -400.0\nmax = {at}\n"


def _block(source: Any, at: DeviceBlock) -> BlockTables:
    config, campaigns = source
    return campaign_block(config, at, campaigns)


def _night(folder: Path, patch: pytest.MonkeyPatch, limits: str, gains: tuple[float, ...]) -> Path:
    folder.mkdir()
    for n, gain in enumerate(gains):
        systematic = replace(healthy().systematic, phase_error_sd_deg=0.3)
        made = replace(healthy(), device_id=f"D{n}", angular_gain=gain, phase_error_deg=1.0, systematic=systematic)
        write_campaign(made, folder / "lot" / f"device-{n}")
    stub_runs(patch, _block)
    call(run_arguments(folder, text=f'[source]\nkind = "campaigns"\npath = "lot"\n{CHAINS}{limits}'))
    return folder / "results"


def _p_pass(results: Path) -> np.ndarray:
    def read(tables: StoredRun) -> np.ndarray:
        devices = Devices(tables.devices)
        assert devices.is_ok().all(), list(devices.text("status_reason"))
        return devices.number("p_pass")

    return with_run(results, list_runs(results)[-1].run_id, read)


def _value(results: Path, name: str) -> float:
    return with_run(results, None, lambda tables: float(Devices(tables.devices).number(name)[0]))


def test_campaigns_that_declare_the_same_are_judged_as_in_a_new_run(
    tmp_path: Path, monkeypatch: Any, capsys: Any
) -> None:
    old = _night(tmp_path / "old", monkeypatch, OLD, (0.7,))
    new_limits = NEW.format(at=round(_value(old, "quadrature_bias_dps"), 2))
    new = _night(tmp_path / "new", monkeypatch, new_limits, (0.7,))
    limits = tmp_path / "new.toml"
    limits.write_text(new_limits, encoding="utf-8")
    capsys.readouterr()
    assert call(["report", "--results", str(old), "--limits", str(limits), "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    expected = _p_pass(new)
    assert 0.2 < expected[0] < 0.8
    assert answer["thinning"]["normal"] == []
    assert [row["p_new"] for row in answer["changed"]] == pytest.approx(expected)


def test_campaigns_that_differ_are_judged_by_estimates_where_biases_are_limited(
    tmp_path: Path, monkeypatch: Any, capsys: Any
) -> None:
    results = _night(tmp_path / "night", monkeypatch, OLD, (0.7, 0.6))
    limits = tmp_path / "new.toml"
    limits.write_text(NEW.format(at=400.0), encoding="utf-8")
    capsys.readouterr()
    assert call(["report", "--results", str(results), "--limits", str(limits), "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["thinning"]["normal"] == ["rate_bias_dps", "quadrature_bias_dps"]
    assert answer["yield"]["new"]["pass"] == 2
