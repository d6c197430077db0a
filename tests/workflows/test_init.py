"""gyroscreen init: foreign files become a campaign that can be read, with guesses that name their reasons."""

from __future__ import annotations

import json
import tomllib

import numpy as np
import pytest

from pipeline.device.model import load_model
from pipeline.experiment.campaign import read_campaign, read_measurement
from workflows.cli import call

FS = 500.0
T = np.arange(600) / FS


def two_files(folder):
    random = np.random.default_rng(1)
    for name, size in (("silent.txt", 0.0), ("chirp.txt", 1.0)):
        drive = size * np.sin(2 * np.pi * (20.0 + 20.0 * T) * T)
        sense = np.convolve(drive, np.exp(-np.arange(60) / 9.0))[:600] + 1e-3 * random.standard_normal(600)
        rows = np.stack([1e3 * T, 1e3 * drive, sense], axis=1)
        np.savetxt(folder / name, rows, delimiter="\t", header="t [ms]\tforce [mV]\tacc (g)", comments="")
    return [str(folder / "silent.txt"), str(folder / "chirp.txt")]


def test_bare_files_become_a_campaign_in_si_units(tmp_path, capsys):
    assert call(["init", *two_files(tmp_path), "--out", str(tmp_path / "c")]) == 0
    printed = capsys.readouterr().out
    assert "column 2 'force [mV]': drive (its name; in mV, read in V" in printed
    silent, driven = read_campaign(tmp_path / "c").records
    assert (silent.role, driven.role) == ("noise", "fit")
    assert silent.sample_rate_hz == pytest.approx(FS)
    assert np.ptp(driven.drive_v) == pytest.approx(2.0, rel=1e-3)
    assert driven.units == {"sense1_V": "m/s^2"}
    assert (tmp_path / "c" / "columns.png").read_bytes().startswith(b"\x89PNG")
    # A campaign is never overwritten.
    assert call(["init", *two_files(tmp_path), "--out", str(tmp_path / "c")]) == 2
    assert "exists already" in capsys.readouterr().err


def test_one_bare_table_is_divided_into_a_fitted_and_a_held_out_half(tmp_path, capsys):
    random = np.random.default_rng(2)
    np.savetxt(tmp_path / "arm.dat", random.standard_normal((1024, 2)))
    assert call(["init", str(tmp_path / "arm.dat"), "--out", str(tmp_path / "c")]) == 0
    assert "sample rate not stated" in capsys.readouterr().out
    fit, held_out = read_campaign(tmp_path / "c").records
    assert (fit.role, held_out.role) == ("fit", "validate")
    assert fit.sense_v.shape == held_out.sense_v.shape == (512, 1)
    assert "NOT STATED" in (tmp_path / "c" / "campaign.toml").read_text()
    # One drive and one sense are no gyro, so there is a model file that fits them.
    assert load_model(tmp_path / "c" / "model.toml").plant.kind == "modal"


def test_files_with_different_columns_are_refused_with_a_way_out(tmp_path, capsys):
    np.savetxt(tmp_path / "a.txt", np.zeros((50, 2)))
    np.savetxt(tmp_path / "b.txt", np.zeros((50, 3)))
    assert call(["init", str(tmp_path / "a.txt"), str(tmp_path / "b.txt"), "--out", str(tmp_path / "c")]) == 5
    assert 'file = ["drive.csv", "sense.csv"]' in capsys.readouterr().err


def test_columns_without_rows_or_of_another_length_are_left_out(tmp_path, capsys):
    random = np.random.default_rng(3)
    columns = {"force": np.sin(20.0 * T), "pick": random.standard_normal(600), "mean": np.ones(7), "none": np.zeros(0)}
    np.savez(tmp_path / "a.npz", **columns)
    assert call(["init", str(tmp_path / "a.npz"), "--out", str(tmp_path / "c")]) == 0
    printed = capsys.readouterr().out
    assert "'mean': not used (7 rows, another column has 600)" in printed
    assert "'none': not used (0 rows, another column has 600)" in printed
    np.savez(tmp_path / "empty.npz", force=np.zeros(0))
    assert call(["init", str(tmp_path / "empty.npz"), "--out", str(tmp_path / "d")]) == 5


def test_a_file_that_rings_down_becomes_a_free_decay(tmp_path, capsys):
    t, w = np.arange(6000) / 1000.0, 2.0 * np.pi * 40.0
    free = np.maximum(t - 1.0, 0.0)
    strain = 2e-4 * np.exp(-1.2 * free) * np.sin(w * t) + 1e-7 * np.random.default_rng(1).standard_normal(t.size)
    rows = np.stack([t, 1.2 + 0.01 * np.sin(3.0 * t), strain], axis=1)
    np.savetxt(tmp_path / "beam.csv", rows, delimiter=",", header="time [s],level [V],strain_0", comments="")
    assert call(["init", str(tmp_path / "beam.csv"), "--out", str(tmp_path / "c")]) == 0
    assert "a free decay from" in capsys.readouterr().out
    records = read_campaign(tmp_path / "c").records
    assert all(record.drive_v.shape[1] == 0 and record.elapsed_s >= 0.0 for record in records)
    assert len(records) >= 6
    # A start value of 1.05 s would lose 3 % of the motion, one before 1 s would include the drive.
    assert 1.0 <= tomllib.loads((tmp_path / "c" / "campaign.toml").read_text())["record"][0]["start_s"] < 1.15


def ring_down_table(path, header, columns):
    np.savetxt(path, np.stack(columns, axis=1), delimiter=",", header=header, comments="")


def test_a_power_in_dbm_becomes_the_amplitude_of_a_decay_once_its_frequency_is_stated(tmp_path, capsys):
    t = np.linspace(0.0, 3.0, 300)
    amplitude = 2e-3 * np.exp(-4.0 * t) + 2e-7 * np.random.default_rng(2).random(t.size)
    ring_down_table(tmp_path / "decay.csv", "time (s),P (dBm)", [t, 10.0 * np.log10(amplitude**2 / 100.0 / 1e-3)])
    folder = tmp_path / "c"
    assert call(["init", str(tmp_path / "decay.csv"), "--out", str(folder)]) == 0
    # The file does not state which mode it shows, and the message says what to write.
    assert "frequency_hz" in capsys.readouterr().out
    text = (folder / "campaign.toml").read_text()
    (folder / "campaign.toml").write_text(text.replace("# frequency_hz = ..  ", "frequency_hz = 1000.0"))
    (record,) = read_measurement(folder).envelopes
    assert np.allclose(record.amplitude_v[:, 0], amplitude, rtol=1e-6)
    assert record.tuned_hz == 1000.0


@pytest.mark.parametrize(
    ("header", "key"), [("t [s],R [mV],f [Hz]", "sense1_R_V"), ("t [s],X [mV],Y [mV],f [Hz]", "sense1_X_V")]
)
def test_the_amplitude_of_a_lock_in_that_falls_is_a_decay_and_one_that_is_swept_is_not(header, key, tmp_path, capsys):
    t = np.linspace(0.0, 3.0, 300)
    amplitude, f = 5.0 * np.exp(-2.0 * t), 1000.0 + 1e-3 * np.random.default_rng(3).standard_normal(t.size)
    parts = [amplitude] if key.endswith("R_V") else [0.6 * amplitude, -0.8 * amplitude]
    ring_down_table(tmp_path / "decay.csv", header, [t, *parts, f])
    assert call(["init", str(tmp_path / "decay.csv"), "--out", str(tmp_path / "c")]) == 0
    text = (tmp_path / "c" / "campaign.toml").read_text()
    assert tomllib.loads(text)["kind"] == "decay_amplitude"
    assert set(tomllib.loads(text)["columns"]) >= {"time_s", "frequency_hz", key}
    (record,) = read_measurement(tmp_path / "c").envelopes
    assert np.allclose(record.amplitude_v[:, 0], 1e-3 * amplitude, rtol=1e-6)
    assert (tmp_path / "c" / "columns.png").stat().st_size > 5_000
    # The same columns with a frequency that is stepped through a resonance are a sweep.
    capsys.readouterr()
    f = np.linspace(995.0, 1005.0, t.size)
    y = 1.0 / (1000.0**2 - f**2 + 1.0j * 1000.0)
    parts = [np.abs(y)] if key.endswith("R_V") else [y.real, y.imag]
    ring_down_table(tmp_path / "sweep.csv", header, [t, *parts, f])
    assert call(["init", str(tmp_path / "sweep.csv"), "--out", str(tmp_path / "s")]) == 0
    assert tomllib.loads((tmp_path / "s" / "campaign.toml").read_text()).get("kind") != "decay_amplitude"


def test_a_constant_column_of_frequency_is_the_reference_and_not_a_measured_frequency(tmp_path, capsys):
    t = np.linspace(0.0, 3.0, 300)
    noise = 1e-3 * np.random.default_rng(4).standard_normal((2, t.size))
    amplitude = np.hypot(2.0 * np.exp(-4.0 * t) + noise[0], noise[1])
    ring_down_table(tmp_path / "decay.csv", "t [s],R [mV],f [Hz]", [t, amplitude, 1000.0 + 0.0 * t])
    folder = tmp_path / "c"
    assert call(["init", str(tmp_path / "decay.csv"), "--out", str(folder)]) == 0
    (record,) = read_measurement(folder).envelopes
    assert record.frequency_hz is None
    assert record.tuned_hz == 1000.0
    capsys.readouterr()
    assert call(["refine", str(folder), "--model", str(folder / "model.toml"), "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["verdict"] == "adequate"
    value, sd = answer["ladder"][-1]["parameters"]["zeta1"]
    assert abs(value - 4.0 / (2.0 * np.pi * 1000.0)) < 4.0 * sd


def test_a_computed_decay_without_noise_is_fitted_and_a_frequency_of_0_hz_is_refused(tmp_path, capsys):
    t = np.linspace(0.0, 3.0, 300)
    for name, f in (("exact", 1000.0), ("still", 0.0)):
        ring_down_table(tmp_path / f"{name}.csv", "t [s],P [W],f [Hz]", [t, 1e-3 * np.exp(-4.0 * t), f + 0.0 * t])
        assert call(["init", str(tmp_path / f"{name}.csv"), "--out", str(tmp_path / name)]) == 0
    capsys.readouterr()
    assert call(["refine", str(tmp_path / "exact"), "--model", str(tmp_path / "exact" / "model.toml"), "--json"]) == 0
    value, _ = json.loads(capsys.readouterr().out)["ladder"][-1]["parameters"]["zeta1"]
    assert value == pytest.approx(2.0 / (2.0 * np.pi * 1000.0), rel=1e-4)
    assert call(["check", str(tmp_path / "still")]) == 5
    assert "not positive" in capsys.readouterr().err
