"""Measured and simulated stepped sweeps through the commands: init, check, compare, refine and the page."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from pipeline.criticism.fit_tests import Rules
from pipeline.criticism.ladder import as_ladder
from pipeline.device.model import load_model
from pipeline.experiment.campaign import read_measurement
from pipeline.learning.joint.answers import joint_answers
from workflows.cli import call

MEASURED = Path(__file__).resolve().parents[3] / "shared" / "data" / "measured"


def ring(f, f0, width, gain):
    """Velocity response of one mode, without any code of the package."""
    s, w0 = 2j * np.pi * f, 2 * np.pi * f0
    return gain * s / (s**2 + 2 * np.pi * width * s + w0**2)


def sweep_file(path, y, f, drive, seed=0, sd=1e-6):
    random = np.random.default_rng(seed)
    y = y + sd * (random.standard_normal(f.size) + 1j * random.standard_normal(f.size))
    rows = np.stack([np.arange(f.size) * 2.0, f, y.real, y.imag, drive], axis=1)
    np.savetxt(path, rows, header="time [s],frequency [Hz],X,Y,drive", delimiter=",", comments="", fmt="%.10g")


def said(capsys, *arguments):
    code = call([str(one) for one in arguments])
    return code, capsys.readouterr()


def test_a_linear_sweep_gives_its_mode_phase_and_offset(tmp_path, capsys):
    up = np.linspace(1180.0, 1220.0, 60)
    f = np.concatenate([up, up[::-1], up, up[::-1]])
    y = 1e-2 * ring(f, 1200.3, 4.0, 30.0) * np.exp(1j * np.deg2rad(25.0)) + 2e-4 - 1e-4j
    sweep_file(tmp_path / "s.csv", y, f, np.full(f.size, 1e-2), sd=2e-5)
    assert said(capsys, "init", tmp_path / "s.csv", "--out", tmp_path / "c")[0] == 0
    code, out = said(capsys, "compare", tmp_path / "c", "--model", tmp_path / "c/model.toml", "--json")
    answer = json.loads(out.out)
    assert code == 0
    assert 0.9 < answer["error"]["fit"] < 1.1
    assert 0.85 < answer["error"]["validate"] < 1.15
    found = answer["parameters"]
    for name, true in (("f1_hz", 1200.3), ("width1_hz", 4.0), ("phase_deg", 25.0), ("offset_s1_x", 2e-4)):
        value, sd = found[name]
        assert abs(value - true) < 4.0 * sd, (name, value, sd)


def test_an_inverted_quadrature_is_named_and_the_advice_can_be_followed(tmp_path, capsys):
    f = np.linspace(1180.0, 1220.0, 80)
    f = np.concatenate([f, f[::-1]])
    sweep_file(tmp_path / "s.csv", np.conj(1e-2 * ring(f, 1200.3, 4.0, 30.0)), f, np.full(f.size, 1e-2))
    said(capsys, "init", tmp_path / "s.csv", "--out", tmp_path / "c")
    _, out = said(capsys, "check", tmp_path / "c", "--json")
    (finding,) = [one for one in json.loads(out.out)["findings"] if one["kind"] == "polarity"]
    assert "gain of -1 for sense1_Y_V" in finding["text"]
    toml = tmp_path / "c" / "campaign.toml"
    toml.write_text(toml.read_text().replace('sense1_Y_V = "Y"', 'sense1_Y_V = { name = "Y", gain = -1.0 }'))
    _, out = said(capsys, "check", tmp_path / "c", "--json")
    assert not [one for one in json.loads(out.out)["findings"] if one["kind"] == "polarity"]


def test_a_gyro_is_identified_from_its_frequency_responses(tmp_path, capsys):
    """theta and split of a gyro outside the paper's band, from four paths in one file with a declared noise."""
    f = np.unique(np.concatenate([np.linspace(5290.0, 5313.0, 200), np.linspace(6050.0, 6150.0, 80)]))
    theta = np.deg2rad(22.5)
    axes = np.array([[np.cos(theta), np.sin(theta)], [-np.sin(theta), np.cos(theta)]])
    sense, drive = np.array([[-1.0, -1.0], [1.0, -1.0]]), np.array([[-1.0, 1.0], [1.0, 1.0]])
    modes = [(5300.0, 2e-4), (5302.5, 1.5e-4), (6100.0, 1e-3)]
    lines = [ring(f, own, 2 * zeta * own, 1.0) for own, zeta in modes]
    h = sum(7.0 * np.einsum("w,ij->wij", y, sense @ np.outer(u, u) @ drive) for y, u in zip(lines, axes))
    h = h + 9.0 * lines[2][:, None, None]
    sd = 1e-3 * np.abs(h).max()
    random = np.random.default_rng(2)
    h = h + sd * (random.standard_normal(h.shape) + 1j * random.standard_normal(h.shape))
    columns = {"frequency_hz": f}
    for j in (0, 1):
        for k in (0, 1):
            stem = f"H_s{j + 1}d{k + 1}"
            columns |= {f"{stem}_re": h[:, j, k].real, f"{stem}_im": h[:, j, k].imag, f"{stem}_sd": np.full(f.size, sd)}
    table = np.stack(list(columns.values()), axis=1)
    np.savetxt(tmp_path / "h.csv", table, header=",".join(columns), delimiter=",", comments="", fmt="%.12g")
    assert said(capsys, "init", tmp_path / "h.csv", "--out", tmp_path / "c")[0] == 0
    assert said(capsys, "check", tmp_path / "c")[0] == 0
    code, out = said(capsys, "identify", tmp_path / "c", "--json")
    found = json.loads(out.out)
    assert (code, found["status"]) == (0, "ok")
    for name, true in (("theta_deg", 22.5), ("split_hz", 2.5), ("f3_hz", 6100.0)):
        assert abs(found[name] - true) < 4.0 * found[f"{name}_sd"], (name, found[name])
    assert found["theta_deg_sd"] < 0.02


@pytest.mark.skipif(not MEASURED.exists(), reason="measured data are not shipped")
def test_wire_1_is_linear_once_the_detector_settles(tmp_path, capsys):
    """f0 3966.7 Hz and width 66.7 Hz are those of a fit without settling, the given model."""
    assert said(capsys, "init", MEASURED / "wire-1.txt", "--out", tmp_path / "c")[0] == 0
    assert {r.role for r in read_measurement(tmp_path / "c").records} == {"fit", "validate"}
    assert said(capsys, "check", tmp_path / "c")[0] == 0
    code, out = said(
        capsys, "refine", tmp_path / "c", "--model", tmp_path / "c/model.toml", "--out", tmp_path / "o", "--json"
    )
    answer = json.loads(out.out)
    assert (code, answer["verdict"], answer["effects"]) == (0, "adequate", ["lockin_settling"])
    assert answer["ladder"][-1]["status"] == "confirmed"
    assert 0.85 < answer["ladder"][-1]["error_validate"] < 1.15
    first = answer["ladder"][0]
    assert first["derived"]["width1_hz"][0] == pytest.approx(66.7, abs=0.15)
    assert first["parameters"]["f1_hz"][0] == pytest.approx(3966.7, abs=0.1)
    assert "Response to single tones" in (tmp_path / "o" / "ladder.html").read_text()


@pytest.mark.skipif(not MEASURED.exists(), reason="measured data are not shipped")
def test_wire_3_softens_but_not_exactly_cubically(tmp_path, capsys):
    """Its first rung: the hysteresis of two levels, up and down; a linear model leaves half of it."""
    assert said(capsys, "init", MEASURED / "wire-3.txt", "--out", tmp_path / "c")[0] == 0
    answers = joint_answers(read_measurement(tmp_path / "c"), load_model(tmp_path / "c/model.toml"))
    rules = Rules()
    ladder = as_ladder(answers.problem, answers.selected(rules)[1], rules)
    assert (ladder.verdict, ladder.terms[0]) == ("unknown", "cubic_stiffness")
    assert "cubic_stiffness" in ladder.wrong_form
    assert ladder.rungs[0].relative_error > 0.45
    assert ladder.rungs[1].relative_error <= 0.13
    value, sd = ladder.rungs[1].parameters["cubic_stiffness.k3"]
    assert value < -10.0 * sd
