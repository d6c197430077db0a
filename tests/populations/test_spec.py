"""Population files: round trips, changed values, and one typed error for each kind of mistake."""

from __future__ import annotations

import pickle
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.errors import ConfigError
from populations.irregularity import find
from populations.spec import DEFAULT, load_spec

TEXT = DEFAULT.read_text(encoding="utf-8")


def written(folder: Path, text: str) -> Path:
    file = folder / "population.toml"
    file.write_text(text, encoding="utf-8")
    return file


def test_default_names_every_shipped_irregularity_and_the_four_assumptions() -> None:
    spec = load_spec()
    assert set(spec.irregularity) == set(find())
    assert spec.angular_gain == 0.7
    assert spec.assumptions() == {
        "angular_gain": 0.7,
        "damping_anisotropy": 0.22,
        "package_stress": 0.123,
        "residual_anisotropy": 0.28,
    }


@given(st.floats(0.01, 2.0), st.floats(0.0, 10.0), st.floats(0.0, 2.0), st.floats(0.0, 100.0), st.text(max_size=20))
def test_changed_population_is_unchanged_by_toml_and_pickle(
    tmp_path_factory: pytest.TempPathFactory, gain: float, residual: float, damping: float, stress: float, name: str
) -> None:
    values = {
        "angular_gain": gain,
        "residual_anisotropy": residual,
        "damping_anisotropy": damping,
        "package_stress": stress,
        "spring_thickness.lot_pct": residual / 2.0,
    }
    spec = load_spec().with_values(values)
    file = written(tmp_path_factory.mktemp("spec"), spec.to_toml().replace('"cloverleaf"', '"x"'))
    again = load_spec(file)
    assert again.irregularity == spec.irregularity
    assert again.device == spec.device
    assert load_spec().angular_gain == 0.7, "the original is not changed"
    assert pickle.loads(pickle.dumps(spec)) == spec


def test_folders_are_relative_to_the_file_and_stored_as_absolute_paths(tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    spec = load_spec(written(tmp_path, 'irregularity_folders = ["mine"]\n' + TEXT))
    assert spec.irregularity_folders == (str((tmp_path / "mine").resolve()),)
    (tmp_path / "elsewhere").mkdir()
    assert load_spec(written(tmp_path / "elsewhere", spec.to_toml())) == spec


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("rocking_hz = 535.5", "rocking_khz = 535.5", "did you mean rocking_hz"),
        (
            "rocking_hz = 535.5",
            'rocking_hz = "535.5 Hz"',
            "device.rocking_hz is not valid: '535.5 Hz'; allowed: a number",
        ),
        ("rocking_hz = 535.5", "rocking_hz = -1.0", "device.rocking_hz is not valid: -1.0; allowed: a number above 0"),
        ("rocking_hz = 535.5", "rocking_hz = nan", "device.rocking_hz is not finite"),
        ("updown_hz = 590.3", "", "updown_hz"),
        ("quality_rocking = 2200.0", "quality_rocking = 9500.0", "leaves no loss to the gas"),
        (
            "lots_per_batch = 5",
            "lots_per_batch = 0",
            "wafer.lots_per_batch is not valid: 0; allowed: a whole number from 1",
        ),
        (
            "lots_per_batch = 5",
            "lots_per_batch = 5.5",
            "wafer.lots_per_batch is not valid: 5.5; allowed: a whole number",
        ),
        ("pitch_mm = 8.0", "pitch_mm = 0.01", "pitch"),
        ("[irregularity.spring_mismatch]", "[irregularity.spring_mismach]", "did you mean spring_mismatch"),
        ("lot_pct = 0.5", "lot_um = 0.5", "did you mean lot_pct"),
        ("die = 0.22", "die = 2.2", "damping_anisotropy. die .* out of range: 2.2; allowed: 0 to 2;"),
        ("die = 0.22", 'die = "22 %"', "damping_anisotropy.die is not valid: '22 %'; allowed: a number"),
        ("die = 0.22", "die = true", "damping_anisotropy.die is not valid: True; allowed: a number"),
        ("hz_per_mpa = 4.8", "", "die_attach_stress. lacks hz_per_mpa"),
        ("[operating]", "[operatng]", "did you mean operating"),
        ('name = "cloverleaf"', "name = cloverleaf", "is not TOML"),
        ('name = "cloverleaf"', 'name = "c"\nirregularity_folders = ["nowhere"]', "the folder does not exist"),
        ('name = "cloverleaf"', 'name = "c"\nirregularity = 3', "is not TOML"),
    ],
)
def test_wrong_population_file_is_a_config_error_that_names_the_fault(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    assert old in TEXT
    with pytest.raises(ConfigError, match=message) as raised:
        load_spec(written(tmp_path, TEXT.replace(old, new, 1)))
    assert raised.value.allowed
    assert raised.value.next_step


def test_missing_file_and_broken_irregularities_are_config_errors(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot be read"):
        load_spec(tmp_path / "absent.toml")
    for name, code, message in (
        ("syntax", "def act(:", "SyntaxError"),
        ("empty", "x = 1", "must define one IRREGULARITY"),
        ("twice", "from populations.irregularities.lid_leak import IRREGULARITY", "must define one IRREGULARITY"),
    ):
        (tmp_path / name).mkdir()
        (tmp_path / name / "mine.py").write_text(code, encoding="utf-8")
        with pytest.raises(ConfigError, match=message):
            load_spec(written(tmp_path, f'irregularity_folders = ["{name}"]\n' + TEXT))


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"residual_anisotrpy": 0.3}, "did you mean residual_anisotropy"),
        ({"package_stress": -1.0}, "out of range"),
        ({"package_stress": float("nan")}, "not finite"),
        ({"angular_gain": 3.0}, "device.angular_gain is not valid"),
        ({"angular_gain": "0.7"}, "device.angular_gain is not valid"),
    ],
)
def test_wrong_changed_value_is_a_config_error_that_names_the_fault(values: dict[str, float], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        load_spec().with_values(values)
