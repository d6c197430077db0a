"""gyroscreen init: foreign files become a campaign that can be read, with guesses that name their reasons."""

from __future__ import annotations

import tomllib

import numpy as np
import pytest

from pipeline.device.model import load_model
from pipeline.experiment.campaign import read_campaign
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
