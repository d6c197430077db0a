"""gyroscreen init: what it guesses from tables of several modes, drives and senses, and that the guesses lead to the modes."""

from __future__ import annotations

import h5py
import numpy as np
import pytest
from scipy.io import savemat
from scipy.linalg import expm

from pipeline.device.model import load_model
from pipeline.experiment.campaign import read_campaign
from pipeline.learning.campaign.answers import campaign_answers
from workflows.cli import call

MODES = ((0.021, 0.02), (0.062, 0.01), (0.13, 0.008))


def displacements(u, modes, shapes_in, shapes_out, rate=1.0):
    """Samples (N, S) of modes (f, zeta) under held drives u (N, D), by the matrix exponential of each mode."""
    y = np.zeros((u.shape[0], shapes_out.shape[0]))
    for (f, zeta), b, c in zip(modes, shapes_in, shapes_out.T):
        w = 2.0 * np.pi * f
        a = np.zeros((2 + u.shape[1],) * 2)
        a[:2, :2], a[1, 2:] = [[0.0, 1.0], [-w * w, -2.0 * zeta * w]], b * w * w
        step = expm(a / rate)[:2]
        x, q = np.zeros(2), np.zeros(u.shape[0])
        for n in range(u.shape[0]):
            q[n] = x[0]
            x = step @ np.concatenate([x, u[n]])
        y += np.outer(q, c)
    return y


def table_of_two_drives(path, senses=2):
    random = np.random.default_rng(3)
    u = random.standard_normal((2048, 2))
    y = displacements(u, MODES, random.standard_normal((3, 2)), random.standard_normal((senses, 3)))
    y += 0.02 * y.std(axis=0) * random.standard_normal(y.shape)
    np.savetxt(path, np.hstack([u, y]), fmt="%.7e")


def test_a_column_that_no_drive_moves_and_that_moves_others_is_a_second_drive(tmp_path, capsys):
    table_of_two_drives(tmp_path / "arm.dat")
    assert call(["init", str(tmp_path / "arm.dat"), "--out", str(tmp_path / "c")]) == 0
    assert "column 2 'column2': drive (moves other columns" in capsys.readouterr().out
    fit = read_campaign(tmp_path / "c").records[0]
    assert (fit.drive_v.shape[1], fit.sense_v.shape[1]) == (2, 2)
    # Two drives and two senses without names are no gyro.
    assert load_model(tmp_path / "c" / "model.toml").plant.kind == "modal"


@pytest.mark.parametrize("senses", [2, 3])
def test_a_mode_far_above_the_others_is_found(senses, tmp_path):
    table_of_two_drives(tmp_path / "arm.dat", senses)
    assert call(["init", str(tmp_path / "arm.dat"), "--out", str(tmp_path / "c")]) == 0
    problem = campaign_answers(read_campaign(tmp_path / "c"), load_model(tmp_path / "c" / "model.toml")).problem
    terms = ("parasitic_mode", "parasitic_mode_2")
    start = problem.fit(())
    for count in range(len(terms) + 1):
        fit = problem.fit(terms[:count], start)
        assert fit.ok
        problem.signatures(fit)  # proposes the frequency of the next mode
        start = fit
    found = sorted(fit.parameters[name][0] for name in ("f1_hz", *(f"{term}.f" for term in terms)))
    assert found == pytest.approx([f for f, _ in MODES], rel=2e-3)
    # Nothing but noise is left, in the fitted half and in the other one.
    sigma = 0.02 * np.loadtxt(tmp_path / "arm.dat")[:, 2:].std(axis=0)
    for record in problem.campaign_fit(terms).records:
        assert record.rms_v == pytest.approx(sigma, rel=0.08)


def test_one_number_beside_the_signals_states_the_sample_rate(tmp_path, capsys):
    random = np.random.default_rng(4)
    u, y = random.standard_normal((2, 1024))
    savemat(tmp_path / "one.mat", {"u": u, "y": y, "fs": 750.0})
    savemat(tmp_path / "two.mat", {"u": u, "y": y, "dt": 0.002})
    rows = [f"{a},{b},{400 if k == 0 else ''}" for k, (a, b) in enumerate(zip(u, y))]
    (tmp_path / "three.csv").write_text("Force,Acceleration,Fs\n" + "\n".join(rows) + "\n")
    np.savez(tmp_path / "four.npz", u=u, y=y, fs=300.0)
    with h5py.File(tmp_path / "five.h5", "w") as file:
        file["run/u"], file["run/y"] = u, y
        file["run"].attrs["Fs"] = 250.0
    rates = {"one.mat": 750.0, "two.mat": 500.0, "four.npz": 300.0, "five.h5": 250.0, "three.csv": 400.0}
    for name, rate in rates.items():
        folder = tmp_path / name.partition(".")[0]
        assert call(["init", str(tmp_path / name), "--out", str(folder)]) == 0
        assert read_campaign(folder).records[0].sample_rate_hz == rate
    assert "sample rate 400 Hz" in capsys.readouterr().out


def test_the_response_to_a_sweep_that_leaves_the_resonance_is_no_free_decay(tmp_path, capsys):
    t = np.arange(16000) / 400.0
    force = np.sin(2.0 * np.pi * (3.0 + 0.15 * t) * t)
    y = displacements(force[:, None], [(6.0, 0.01)], np.ones((1, 1)), np.ones((1, 1)), 400.0)[:, 0]
    y += 1e-3 * y.std() * np.random.default_rng(5).standard_normal(y.size)
    np.savetxt(
        tmp_path / "sweep.csv", np.stack([t, force, y], axis=1), delimiter=",", header="time,force,y", comments=""
    )
    assert call(["init", str(tmp_path / "sweep.csv"), "--out", str(tmp_path / "c")]) == 0
    assert "free decay" not in capsys.readouterr().out
