"""Virtual devices with a trim after the test, and with effects that the screening model lacks."""

import numpy as np
import pytest

from pipeline.errors import ConfigError
from workflows.config import load_config
from workflows.screening.block import DeviceBlock, virtual_block
from workflows.screening.plan import plan


def rows(tmp_path, text, count=6):
    path = tmp_path / "run.toml"
    path.write_text(text)
    return virtual_block(load_config(path), DeviceBlock(0, 0, count)).devices.to_pylist()


def test_the_true_split_after_the_trim_agrees_with_its_prediction(tmp_path):
    found = rows(tmp_path, "[trim]\nsplit_hz = 0.5\ntheta_deg = 0.0\n", 10)
    z = [(r["trimmed_true_split_hz"] - r["trimmed_split_hz"]) / r["trimmed_split_hz_sd"] for r in found]
    assert np.sqrt(np.mean(np.square(z))) < 2.5
    for r in found:
        assert r["trimmed_true_split_hz"] == pytest.approx(0.5, abs=0.6)
        assert len(r["trim_voltages_v"].split(",")) == 4


def test_a_trim_with_almost_no_voltage_changes_neither_split_nor_verdict(tmp_path):
    found = rows(tmp_path, "[trim]\nsplit_hz = 0.0\nmost_v = 1e-6\n", 2)
    for r in found:
        assert r["trim_at_limit"] == 1.0
        assert r["trimmed_split_hz"] == pytest.approx(r["split_hz"], abs=1e-6)
        assert r["trimmed_verdict"] == r["verdict"]


def test_an_effect_outside_the_model_is_flagged_as_misfit(tmp_path):
    found = rows(tmp_path, '[experiment]\neffects = ["updown_tilt", "sense_nonlinearity"]\n')
    assert sum(r["status"] == "misfit" for r in found) >= 3
    for r in found:
        if r["status"] == "misfit":
            assert r["verdict"] == "undecided"
            assert "error" in r["status_reason"] or "bias" in r["status_reason"]


def test_an_effect_that_the_population_does_not_draw_is_a_config_error(tmp_path):
    path = tmp_path / "run.toml"
    path.write_text('[experiment]\neffects = ["loop_delay"]\n')
    with pytest.raises(ConfigError, match="does not draw sizes"):
        plan(load_config(path))
