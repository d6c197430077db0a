"""Stored draws judged by new limits against a new run by these limits: with all draws stored, the same to the last bit.

The noise, the systematic errors and the limits are chosen so that devices lie near limits and near the gate.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w

from pipeline.store.columns import StoredRun, with_run
from pipeline.store.run import create_run
from pipeline.toml_files import converted
from reports.common_errors import GivenCommon, given_common
from reports.devices import Devices
from reports.limits import load_limits
from workflows.config import RunConfig, to_toml_table
from workflows.screening.block import DeviceBlock, virtual_block
from workflows.screening.plan import without_none
from workflows.what_if.run import JudgedRun, judged_run

DEVICES = 8
#: Draws of a device: 4 ensembles of 24 walkers with 4 steps.
DRAWS = 384
BASE: dict[str, Any] = {
    "run": {"devices": DEVICES, "seed": 5},
    "noise": {"sigma_v": 0.05},
    "gate": {"bias_fraction": 0.06, "theta_bias_max_deg": 2.0},
    "systematic": {
        "phase_error_sd_deg": 0.5, "angular_gain_sd": 0.01, "clock_sd_ppm": 900.0, "temperature_sd_c": 5.0, "gain_sd": 0.02
    },
    "operation": {"drive_amplitude_v": 1.0},
    "posterior": {"walkers": 24, "steps": 4, "rhat_max": 2.0, "ess_min": 10.0},
}  # fmt: skip
OLD = {
    "f1_hz": {"min": 534.0},
    "split_hz": {"max": 6.0},
    "rate_bias_dps": {"min": -25.0, "max": 25.0},
    "scale_factor_v_per_dps": {"min": 0.3e-3},
}
#: The gate refuses devices 1, 2, 6 and 7 by the width of the limit on quality2.
NEW = {
    "f1_hz": {"min": 533.0, "max": 536.5},
    "quality2": {"min": 900.0},
    "rate_bias_dps": {"min": -30.0, "max": 23.0},
    "scale_factor_v_per_dps": {"min": 0.3e-3},
    "theta_deg": {"min": -88.0, "max": 88.0},
}


def _run(folder: Path, limits: dict[str, Any], rule: Any, stored: int) -> None:
    table = {**BASE, "posterior": {**BASE["posterior"], "stored_draws": stored}, "limits": limits, "rule": rule}
    config = converted(table, RunConfig, "run")
    store = create_run(folder, "r", tomli_w.dumps(without_none(to_toml_table(config))), {"seed": 0})
    found = virtual_block(config, DeviceBlock(0, 0, DEVICES))
    store.commit_block(0, found.devices, found.posterior)
    store.finish("complete", {})


def _again(folder: Path, limits: dict[str, Any], rule: Any) -> JudgedRun:
    return judged_run(folder, "r", load_limits({"limits": limits, "rule": rule}), "new.toml")


def _columns(folder: Path) -> dict[str, Any]:
    def read(tables: StoredRun) -> dict[str, Any]:
        return _table(Devices(tables.devices))

    return with_run(folder, "r", read)


def _table(devices: Devices) -> dict[str, Any]:
    return {
        **{name: list(devices.text(name)) for name in ("status", "verdict", "failed_limits")},
        "p_pass": devices.number("p_pass").tolist(),
    }


def _given(folder: Path, rule: Any) -> GivenCommon | None:
    def read(tables: StoredRun) -> GivenCommon | None:
        return given_common(Devices(tables.devices), tables.posterior, rule)

    return with_run(folder, "r", read)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run by the old limits that stores all draws."""
    folder = tmp_path_factory.mktemp("whole")
    _run(folder, OLD, "probability", DRAWS)
    return folder


@pytest.fixture(scope="module")
def by_new(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same devices in a run by the new limits."""
    folder = tmp_path_factory.mktemp("by_new")
    _run(folder, NEW, "probability", DRAWS)
    return folder


@pytest.mark.parametrize("backwards", [False, True])
def test_all_draws_give_what_a_new_run_gives(whole: Path, by_new: Path, backwards: bool) -> None:
    first, second, limits = (by_new, whole, OLD) if backwards else (whole, by_new, NEW)
    found, expected = _again(first, limits, "probability"), _columns(second)
    after = _table(found.after)
    p = np.array(expected["p_pass"])
    assert np.sum((p > 0.01) & (p < 0.99)) >= 2, "the case does not test probabilities"
    assert _columns(first)["status"] != expected["status"], "the case does not test the gate"
    assert after["status"] == expected["status"]
    np.testing.assert_allclose(after["p_pass"], p, atol=1e-12)
    assert after["verdict"] == expected["verdict"]
    assert after["failed_limits"] == expected["failed_limits"]
    given = _given(second, found.content.new.rule)
    assert given is not None
    assert found.given is not None
    # One of 200 draws may fall on the other side of a limit by rounding.
    np.testing.assert_allclose(found.given.p_pass, given.p_pass, atol=0.0051)
    assert np.nanmean(np.abs(found.given.p_pass - given.p_pass)) < 1e-4


def test_the_same_limits_give_the_run_itself(whole: Path) -> None:
    found, run = _again(whole, OLD, "probability"), _columns(whole)
    after = _table(found.after)
    np.testing.assert_array_equal(after.pop("p_pass"), run.pop("p_pass"))
    assert after == run
    assert found.content.changed == ()
    assert found.content.total.old == found.content.total.new


@pytest.mark.parametrize("stored", [0, 40])
@pytest.mark.parametrize(
    "rule", ["simple", {"kind": "guard_band", "k": 1.0}, {"kind": "guard_band", "consumer_risk": 0.1}]
)
def test_rules_by_estimate_need_no_draws(tmp_path: Path, stored: int, rule: Any) -> None:
    _run(tmp_path / "old", OLD, "probability", stored)
    _run(tmp_path / "new", NEW, rule, stored)
    after, expected = _table(_again(tmp_path / "old", NEW, rule).after), _columns(tmp_path / "new")
    after.pop("p_pass"), expected.pop("p_pass")
    assert after == expected


def test_thinned_draws_give_the_run_itself_and_say_what_they_cost(tmp_path: Path, by_new: Path) -> None:
    _run(tmp_path, OLD, "probability", 100)
    same = _again(tmp_path, OLD, "probability")
    after, run = _table(same.after), _columns(tmp_path)
    np.testing.assert_array_equal(after.pop("p_pass"), run.pop("p_pass"))
    assert after == run
    found = _again(tmp_path, NEW, "probability")
    assert found.content.thinning is not None
    assert (found.content.thinning.stored, found.content.thinning.of) == (100, DRAWS)
    exact, p = np.array(_columns(by_new)["p_pass"]), found.after.number("p_pass")
    # 100 of 384 draws: five Monte Carlo sd of a share.
    np.testing.assert_allclose(p, exact, atol=0.25, equal_nan=True)
