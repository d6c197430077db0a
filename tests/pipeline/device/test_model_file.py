"""Model files: written and read back unchanged; a wrong file is one ConfigError."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.device.model import SCREENING_MODEL, Model, PlantSpec, load_model
from pipeline.errors import ConfigError


@pytest.mark.parametrize(
    "model",
    [
        Model(),
        SCREENING_MODEL,
        Model(
            PlantSpec("modal", 2, "displacement"),
            ("cubic_stiffness", "mains_hum"),
            {"f1_hz": 68.25, "mains_hum.f": 50.0},
            {"cubic_stiffness.k3": "uniform(-1e6, 1e6)"},
        ),
        Model(effects=("electrostatic_softening",), prior={"electrostatic_softening.1/g": "normal(10, 2.5)"}),
    ],
)
def test_a_model_is_unchanged_by_writing_and_reading_its_file(model: Model, tmp_path: Path) -> None:
    path = tmp_path / "model.toml"
    path.write_text(model.to_toml(), encoding="utf-8")
    assert load_model(path) == model


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ('plant = "gyros"', "plant is not valid: 'gyros'"),
        ('plant = { kind = "modal", modes = 0 }', "plant.modes is not valid: 0; allowed: a whole number from 1 to 64"),
        ('effects = ["warp_drive"]', "no such effect"),
        ('effects = "cubic_stiffness"', "effects is not valid: 'cubic_stiffness'; allowed: a list"),
        ('effects = ["cubic_stiffness", "cubic_stiffness"]', "named twice"),
        ('plant = { kind = "modal" }\neffects = ["angular_rate"]', "does not apply"),
        ("[fixed]\nf9_hz = 1.0", "no such parameter"),
        ('[fixed]\nf1_hz = "fast"', "fixed.f1_hz is not valid: 'fast'; allowed: a number"),
        ('[prior]\nf1_hz = "normal(1)"', "cannot be read"),
        ('[prior]\nf1_hz = "uniform(2, 1)"', "cannot be read"),
        ("colour = 1", "unknown key"),
        ("plant = ", "is not TOML"),
    ],
)
def test_a_wrong_model_file_is_a_config_error(text: str, match: str, tmp_path: Path) -> None:
    path = tmp_path / "model.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError, match=match):
        load_model(path)


def test_adding_and_dropping_an_effect_gives_the_model_back() -> None:
    larger = SCREENING_MODEL.with_effect("gain_drift")
    assert larger.without_effect("gain_drift") == SCREENING_MODEL
    assert larger.free[-1] == "gain_drift.gamma"
    assert "gain_drift" not in larger.candidates()


@given(
    theta=st.floats(-89.9, 90.0),
    split=st.floats(1e-3, 20.0),
    ratio=st.floats(-0.99, 0.99),
    with_c12=st.booleans(),
)
def test_smooth_coordinates_round_trip(theta: float, split: float, ratio: float, with_c12: bool) -> None:
    model = SCREENING_MODEL if with_c12 else Model()
    zeta1, zeta2 = 3e-4, 2e-4
    values = dict.fromkeys(model.free, 0.1) | {
        "f1_hz": 534.5,
        "f2_hz": 534.5 + split,
        "f3_hz": 590.0,
        "zeta1": zeta1,
        "zeta2": zeta2,
        "theta_deg": theta,
    }
    if with_c12:
        values["c12_per_s"] = ratio * 4.0 * np.pi * 534.5 * np.sqrt(zeta1 * zeta2)
    found = model.to_values(model.to_internal(values))
    for name, value in values.items():
        assert found[name] == pytest.approx(value, rel=1e-8, abs=1e-7 / split if name == "theta_deg" else 1e-9)
