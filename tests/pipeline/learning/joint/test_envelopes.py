"""Free decays as amplitude against time: the slow flow, the noise floor, the filter, and the loop on them."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from pipeline.device.model import Model, PlantSpec
from pipeline.experiment.envelopes import EnvelopeRecord, amplitude_sd, mean_amplitude
from pipeline.experiment.forward.envelopes import decay, mode_near, slow_flow
from pipeline.experiment.forward.system import Conditions, assemble
from pipeline.experiment.instrument import Instrument
from pipeline.experiment.tones import ToneCampaign, ToneRecord
from pipeline.learning.joint.answers import joint_answers
from workflows.cli import call
from workflows.learning import compare

MODEL = Model(PlantSpec("modal", 1, "displacement"))
F0, WIDTH = 1000.0, 1.0


def flow_of(effects, values, f0, q, seconds):
    model = Model(PlantSpec("modal", 1, "displacement", 1, 0))
    for name in effects:
        model = model.with_effect(name)
    complete = model.complete({"f1_hz": f0, "zeta1": 0.5 / q, **values})
    system = assemble(model, complete, Instrument(1.0), Conditions(0.0, 0.0, None))
    return slow_flow(system, mode_near(system, f0), 1e-4, 1.5, seconds)


def fundamental(solution, w0, times):
    """Amplitude and frequency of the first harmonic around ``times``, by least squares over five periods."""
    amplitude, omega = [], []
    for t0 in times:
        x = np.linspace(-2.5, 2.5, 320) * 2 * np.pi / w0
        y, w = solution.sol(t0 + x)[0], w0
        for _ in range(6):
            columns = [np.ones_like(x)]
            columns += [turn(h * w * x) for h in (1, 2, 3) for turn in (np.cos, np.sin)]
            columns += [x**k * turn(w * x) for k in (1, 2) for turn in (np.cos, np.sin)]
            c = np.linalg.lstsq(np.stack(columns, axis=1), y, rcond=None)[0]
            w += ((c[7] - 1j * c[8]) / (c[1] - 1j * c[2])).imag
        amplitude.append(abs(c[1] - 1j * c[2]))
        omega.append(w)
    return np.array(amplitude), np.array(omega)


@pytest.mark.parametrize(
    ("effect", "size", "bounds"),
    [
        ("cubic_stiffness.k3", 0.05, (1e-4, 5e-5)),
        ("quadratic_stiffness.k2x", 0.1, (3e-4, 2e-5)),
        ("nonlinear_damping.d", 2.5e-3, (1e-5, 5e-6)),
        ("damping_drift.gamma", 0.5, (1e-5, 5e-6)),
    ],
)
def test_the_slow_flow_equals_the_time_integration(effect, size, bounds):
    """Q = 200, frequency moves by 1.6 % (cubic), 0.4 % (quadratic), damping doubles: bounds of amplitude and frequency."""
    f0, q, seconds = 100.0, 200.0, 1.5
    w0 = 2 * np.pi * f0
    law = {
        "cubic_stiffness.k3": lambda t, x, v: -size * w0**2 * x**3,
        "quadratic_stiffness.k2x": lambda t, x, v: -size * w0**2 * x**2,
        "nonlinear_damping.d": lambda t, x, v: -size * abs(v) * v,
        "damping_drift.gamma": lambda t, x, v: -size * t * w0 / q * v,
    }[effect]
    scaled = size * w0**2 if "stiffness" in effect else size
    exact = solve_ivp(
        lambda t, y: [y[1], -(w0**2) * y[0] - w0 / q * y[1] + law(t, y[0], y[1])],
        (-0.05, seconds + 0.1), [1.0, 0.0], method="DOP853", rtol=1e-9, atol=1e-11, dense_output=True,
    )  # fmt: skip
    times = np.linspace(0.0, seconds, 31)
    amplitude, omega = fundamental(exact, w0, times)
    flow = flow_of([effect.split(".")[0]], {effect: scaled}, f0, q, seconds)
    start = np.log(amplitude[0])
    for _ in range(3):
        start += np.log(amplitude[0] / decay(flow, start, times)[0][0, 0])
    tone, _, _, found = decay(flow, start, times)
    assert np.abs(tone[:, 0] / amplitude - 1.0).max() < bounds[0]
    assert np.abs(found / omega - 1.0).max() < bounds[1]


def test_noise_adds_to_an_amplitude_as_rice_says():
    random = np.random.default_rng(0)
    for a in (0.0, 0.7, 3.0, 20.0):
        for n in (1, 4):
            noise = random.standard_normal((2, 200_000, n))
            drawn = np.sqrt(np.mean((a + noise[0]) ** 2 + noise[1] ** 2, axis=1))
            sd = drawn.std() / np.sqrt(drawn.size)
            at = np.array([a])
            assert abs(mean_amplitude(at, 1.0, n)[0] - drawn.mean()) < 4.0 * sd
            assert amplitude_sd(at, 1.0, n)[0] == pytest.approx(drawn.std(), rel=0.01)


def ring(seed, sd, rows=300, seconds=6.0, bend=None, tuned=F0, phase=False, name="ring"):
    """|a e^{i phi} + noise| of a linear decay, or of a given (amplitude, phase) law."""
    t, random = np.linspace(0.0, seconds, rows), np.random.default_rng(seed)
    a, turn = (np.exp(-np.pi * WIDTH * t), 0.0 * t) if bend is None else bend(t)
    z = a * np.exp(1j * turn) + sd * (random.standard_normal(rows) + 1j * random.standard_normal(rows))
    angle = np.unwrap(np.angle(z))[:, None] if phase else None
    return EnvelopeRecord(name, t, np.abs(z)[:, None], angle, tuned_hz=tuned)


def campaign(*records, tones=()):
    return ToneCampaign("decay", tuple(tones), Instrument(1.0), envelopes=records)


def test_a_noise_floor_does_not_bias_the_damping():
    """A third of each decay is below a floor of 2 %; without it in the model, the damping is 3 sd too small in the mean."""
    scores, plain = [], []
    for seed in range(12):
        for found, floor in ((scores, None), (plain, 0.0)):
            problem = joint_answers(campaign(ring(seed, 0.02)), MODEL).problem
            # Candidates take most of the time.
            problem.__dict__["_term_sizes"], problem.__dict__["terms"] = [{}], ()
            if floor is not None:
                problem._fixed["floor_r1_s1"] = problem.start["floor_r1_s1"] = floor
            value, sd = problem.fit(()).parameters["zeta1"]
            found.append((value - 0.5 * WIDTH / F0) / sd)
    assert abs(np.mean(scores)) < 3.0 / np.sqrt(12)
    assert 0.5 < np.std(scores) < 1.6
    assert np.mean(plain) < -3.0


def test_a_filter_of_the_detector_follows_the_decay():
    """A low-pass of one pole, integrated, on a decay with drag: the model with its time constant finds the drag, not more."""
    g, h, lag = np.pi * WIDTH, 4.0, 0.03
    fine = np.linspace(0.0, 4.0, 40_001)
    a = g / ((g + h) * np.exp(g * fine) - h)
    filtered = np.empty_like(a)
    filtered[0], decayed = a[0], np.exp(-(fine[1] - fine[0]) / lag)
    for k in range(1, a.size):
        filtered[k] = decayed * filtered[k - 1] + (1.0 - decayed) * 0.5 * (a[k] + a[k - 1])
    random, rows = np.random.default_rng(1), slice(None, None, 50)
    z = filtered[rows] + 1e-3 * (random.standard_normal(801) + 1j * random.standard_normal(801))
    plain = EnvelopeRecord("lag", fine[rows], np.abs(z)[:, None], tuned_hz=F0, time_constant_s=lag)
    model = MODEL.with_effect("nonlinear_damping")
    found = compare(campaign(plain), model).answer.parameters
    for name, true in (("zeta1", 0.5 * WIDTH / F0), ("nonlinear_damping.d", h * 3 * np.pi / 4 / (2 * np.pi * F0))):
        value, sd = found[name]
        assert abs(value - true) < 4.0 * sd, (name, value, sd, true)


def test_a_decay_and_a_sweep_share_the_mode():
    """The sweep shows the frequency, both show the damping: their information adds up."""
    f = np.tile(np.linspace(F0 - 3.0, F0 + 3.0, 60), 2)
    s, w0, random = 2j * np.pi * f, 2 * np.pi * F0, np.random.default_rng(3)
    y = 1e4 / (s**2 + 2 * np.pi * WIDTH * s + w0**2)
    sd = 5e-3 * np.abs(y).max()
    y = y + sd * (random.standard_normal(f.size) + 1j * random.standard_normal(f.size))
    ones = np.ones((f.size, 1), dtype=np.complex128)
    sweep = ToneRecord("sweep", "sweep", f, ones, y[:, None], sd_v=np.full((f.size, 1), sd), role="fit")
    parts = (campaign(ring(5, 0.005)), campaign(tones=[sweep]), campaign(ring(5, 0.005), tones=[sweep]))
    decayed, swept, both = (compare(one, MODEL).answer.parameters for one in parts)
    assert "f1_hz" not in decayed
    assert both["f1_hz"][1] == pytest.approx(swept["f1_hz"][1], rel=0.05)
    expected = (decayed["zeta1"][1] ** -2 + swept["zeta1"][1] ** -2) ** -0.5
    assert both["zeta1"][1] == pytest.approx(expected, rel=0.05)
    assert abs(both["zeta1"][0] - 0.5 * WIDTH / F0) < 4.0 * both["zeta1"][1]


def test_the_loop_on_a_file_in_dbm(tmp_path, capsys):
    """check, identify, refine: the cubic stiffness of a ring-down with its phase, from a spectrum analyzer and a lock-in."""
    bend = lambda t: (np.exp(-np.pi * WIDTH * t), 3.0 * (1.0 - np.exp(-2 * np.pi * WIDTH * t)) / (2 * np.pi * WIDTH))  # noqa: E731
    record = ring(7, 2e-3, rows=400, bend=bend, phase=True)
    level = 20.0 * np.log10(record.amplitude_v[:, 0] / np.sqrt(2.0) / np.sqrt(50.0 * 1e-3))
    table = np.stack([record.time_s, level, np.rad2deg(np.angle(np.exp(1j * record.phase_rad[:, 0])))], axis=1)
    np.savetxt(tmp_path / "ring.csv", table, header="t,P,phi", delimiter=",", comments="", fmt="%.8g")
    (tmp_path / "model.toml").write_text('plant = { kind = "modal", modes = 1, sense = "displacement" }\n')
    entry = 'columns = { time_s = "t", sense1_dBm = "P", sense1_phase_deg = "phi" }\n'
    head = f'kind = "decay_amplitude"\n[[record]]\nfile = "ring.csv"\n{entry}'
    (tmp_path / "campaign.toml").write_text(head)
    assert call(["check", str(tmp_path)]) == 5
    assert "nothing states the frequency" in capsys.readouterr().err
    (tmp_path / "campaign.toml").write_text(head + f"frequency_hz = {F0}\n")
    assert call(["check", str(tmp_path), "--json"]) == 0
    assert not [f for f in json.loads(capsys.readouterr().out)["findings"] if f["severity"] != "note"]
    common = [str(tmp_path), "--model", str(tmp_path / "model.toml"), "--json"]
    call(["refine", *common, "--out", str(tmp_path / "o")])
    answer = json.loads(capsys.readouterr().out)
    assert (answer["verdict"], answer["effects"]) == ("adequate", ["cubic_stiffness"])
    value, sd = answer["parameters"]["f1_hz"]
    assert abs(value - F0) < 4.0 * sd
    # W = w0 + 3 k3 a^2 / 8 w0 moves the phase by 3 rad/s at the first amplitude.
    value, sd = answer["parameters"]["cubic_stiffness.k3"]
    assert abs(value - 3.0 * 8.0 * 2 * np.pi * F0 / 3.0) < 4.0 * sd
