"""Modal records: the paper's equation (14), round trips, and error messages."""

from pathlib import Path

import numpy as np
import pytest

from pipeline.errors import ConfigError, GyroscreenError, MeasurementError, UsageError
from pipeline.experiment.antialias import filter_response
from pipeline.experiment.campaign import read_measurement
from pipeline.experiment.files.modal_record import ModalRecord, read_modal_record, write_modal_record
from pipeline.experiment.instrument import AntiAlias

EQ14 = Path(__file__).resolve().parents[5] / "shared" / "paper" / "eq14.toml"


def example(sd=True, shape=(2, 3)):
    random = np.random.default_rng(2)
    return ModalRecord(
        name="A17",
        frequency_hz=np.array([534.5, 536.4]),
        zeta=np.array([3.167e-4, 1.0 / 3.0e3]),
        R1=random.standard_normal((2, *shape)),
        R0=1e4 * random.standard_normal((2, *shape)),
        sd=random.uniform(0.1, 1.0, (2, 2, *shape)) if sd else None,
        antialias=AntiAlias() if sd else None,
        rate_dps=0.0 if sd else None,
        angular_gain=0.7 if sd else None,
        phase_error_deg=1.5,
        drive="f2",
        reference={"split_hz": (1.9, 0.05)} if sd else {},
    )


@pytest.mark.parametrize("sd", [True, False])
@pytest.mark.parametrize("shape", [(1, 1), (2, 2), (2, 3)])
def test_round_trip_keeps_every_number(tmp_path, sd, shape):
    written = example(sd, shape)
    write_modal_record(written, tmp_path / "m.toml")
    read = read_measurement(tmp_path / "m.toml")
    assert isinstance(read, ModalRecord)
    for name in ("frequency_hz", "zeta", "R1", "R0", "sd"):
        assert np.array_equal(getattr(read, name), getattr(written, name))
    for name in ("name", "antialias", "rate_dps", "angular_gain", "phase_error_deg", "drive", "reference"):
        assert getattr(read, name) == getattr(written, name)


@pytest.mark.skipif(not EQ14.exists(), reason="the paper is not beside the project")
def test_the_papers_residues_are_velocities_behind_its_filter():
    record = read_modal_record(EQ14)
    assert record.rate_dps == 0.0
    w = 2.0 * np.pi * record.frequency_hz[:, None, None]
    at_resonance = (1j * w * record.R1 + record.R0) / (1j * w)
    velocity = at_resonance / filter_response(record.antialias, 1j * w)
    # Residues of a velocity are real at resonance; those of the paper are to 7 %, and M3 agrees with the printed one.
    assert np.linalg.norm(velocity.imag) < 0.08 * np.linalg.norm(velocity.real)
    assert velocity[2].real == pytest.approx(np.array([[27.49, 27.53], [29.70, 29.74]]), abs=0.03)


MODE = "[[mode]]\nfrequency_hz = 534.5\nzeta = 3e-4\nR1 = [[1.0, 2.0]]\nR0 = [[3.0, 4.0]]\n"


@pytest.mark.parametrize(
    ("text", "kind", "words"),
    [
        ("kind = 'modal'\n", ConfigError, ["missing", "mode"]),
        ("kind = 'modal'\nrate = 0.0\n" + MODE, ConfigError, ["did you mean rate_dps"]),
        ("kind = 'modal'\n" + MODE + "Q = 3\n", ConfigError, ["mode[0]", "Q"]),
        ("kind = 'modal'\n" + MODE.replace("3e-4", "0.0"), ConfigError, ["zeta"]),
        ("kind = 'modal'\n" + MODE.replace("534.5", "-1.0"), ConfigError, ["frequency_hz"]),
        ("kind = 'modal'\n" + MODE.replace("[[3.0, 4.0]]", "[[3.0], [4.0]]"), MeasurementError, ["R0", "1 rows of 2"]),
        ("kind = 'modal'\n" + MODE.replace("2.0]]", "nan]]"), MeasurementError, ["R1", "finite"]),
        ("kind = 'modal'\n" + MODE + "sd = [[[1.0, 1.0]]]\n", ConfigError, ["sd"]),
        ("kind = 'modal'\n" + MODE + "sd = [[[1.0, 1.0]], [[1.0, 0.0]]]\n", MeasurementError, ["sd", "positive"]),
        (
            "kind = 'modal'\n" + MODE + "sd = [[[1.0, 1.0]], [[1.0, 1.0]]]\n" + MODE,
            MeasurementError,
            ["sd for all modes"],
        ),
        ("kind = 'modal'\n[reference]\nsplit = [1.0, 0.1]\n" + MODE, ConfigError, ["did you mean split_hz"]),
        (MODE, ConfigError, ['kind = "modal"']),
    ],
)
def test_a_wrong_modal_record_gives_a_typed_message(tmp_path, text, kind, words):
    path = tmp_path / "m.toml"
    path.write_text(text)
    with pytest.raises(GyroscreenError) as error:
        read_modal_record(path)
    assert type(error.value) is kind
    for word in words:
        assert word in str(error.value)


def test_an_unwritable_path_is_a_usage_error(tmp_path):
    with pytest.raises(UsageError, match="cannot be written"):
        write_modal_record(example(), tmp_path / "missing" / "m.toml")
