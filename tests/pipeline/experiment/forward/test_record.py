"""The forward model against an independent solution: the laws as documented, with the filter states, solved by DOP853."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from plants import PAPER_LIKE as PLANT
from scipy.integrate import DOP853
from scipy.signal import butter

from pipeline.arrays import FloatArray
from pipeline.device.model import DEFAULT_COMPARE_MODEL, SCREENING_MODEL, Model, PlantSpec
from pipeline.errors import ConfigError, MeasurementError
from pipeline.experiment.excitation import Chirp, drive_samples
from pipeline.experiment.forward.drive_groups import drive_group_of
from pipeline.experiment.forward.record import base_of, forward, jacobian, signatures
from pipeline.experiment.instrument import AntiAlias, Instrument
from pipeline.experiment.record import Record

INSTRUMENT = Instrument(antialias=AntiAlias())
RATE = 10_000.0
BIAS = 5.0
M_S = np.array([[-1.0, -1.0], [1.0, -1.0]])
M_D = np.array([[-1.0, 1.0], [1.0, 1.0]])


def _record(samples: int, level: float = 2.0, **declared: Any) -> Record:
    drive = drive_samples(Chirp((500.0, 620.0), (620.0, 500.0), (level, level), samples / RATE), RATE)
    return Record("chirp", RATE, drive, np.zeros_like(drive), **declared)


def _oracle(effect: str, p: list[float], v: FloatArray, first_order: bool, order: int = 8) -> FloatArray:
    """The record by DOP853 (rtol 1e-10), hold interval by hold interval; shares no code with the model."""
    omega = 2.0 * np.pi * np.array([PLANT["f1_hz"], PLANT["f2_hz"], PLANT["f3_hz"]])
    theta = np.deg2rad(PLANT["theta_deg"])
    rotation = np.array([[np.cos(theta), np.sin(theta)], [-np.sin(theta), np.cos(theta)]])
    c12 = p[0] if effect == "offdiagonal_damping" else 0.0
    k = rotation.T @ np.diag(omega[:2] ** 2) @ rotation
    c = rotation.T @ np.array([[2 * PLANT["zeta1"] * omega[0], c12], [c12, 2 * PLANT["zeta2"] * omega[1]]]) @ rotation
    k33, c33 = omega[2] ** 2, 2.0 * PLANT["zeta3"] * omega[2]
    s, d = PLANT["sense_imbalance"], PLANT["drive_imbalance"]
    m_d, m_s = p if effect == "electrode_mismatch" else (0.0, 0.0)
    k_d, k_s = np.array([1 - d, 1 + d]), np.array([1 - s, 1 + s])
    k_dr, k_sr = np.array([1 - d - m_d, 1 + d + m_d]), np.array([1 - s - m_s, 1 + s + m_s])
    phi = np.deg2rad(p[0]) if effect == "electrode_misalignment" else 0.0
    misaligned = np.array([[np.cos(phi), -np.sin(phi)], [np.sin(phi), np.cos(phi)]])
    t_x = p[0] if effect == "updown_tilt" else 0.0
    rate = p[0] if effect == "angular_rate" else 0.0
    _, poles, _ = butter(order, 2.0 * np.pi * 4800.0, analog=True, output="zpk")
    sections = [(abs(q), -2.0 * q.real) for q in poles if q.imag > 0.0]
    slow = 2 if effect == "pickoff_pole" else 0

    def motion(t: float, y: FloatArray, v_now: FloatArray, slope: FloatArray, t0: float) -> FloatArray:
        psi, z, psid, zd = y[:2], y[2], y[3:5], y[5]
        volts = v_now + slope * (t - t0)
        u = volts
        if effect == "drive_nonlinearity":
            u = u + p[0] * u**2 / (2.0 * BIAS)
        if effect == "electrostatic_softening":
            x = M_D.T @ psi + z
            u = (BIAS / 2.0 + u) / (1.0 - p[0] * x) ** 2 - BIAS / 2.0 - BIAS * x * p[0]
        beta, gamma = (p[0] * t if effect == e else 0.0 for e in ("frequency_drift", "damping_drift"))
        a = PLANT["rocking_gain"] * misaligned @ M_D @ (k_dr * u) - (1 + gamma) * c @ psid - (1 + beta) * k @ psi
        a = a - 2.0 * rate * np.array([-psid[1], psid[0]])
        if effect == "cubic_stiffness":
            a = a - p[0] * (psi @ psi) * psi
        if effect == "quadratic_stiffness":
            a = a - np.array(p) * psi**2
        if effect == "nonlinear_damping":
            a = a - p[0] * np.sqrt(psid @ psid) * psid
        az = PLANT["updown_gain"] * (np.sum(k_d * u) - t_x * (M_D @ (k_d * u))[0])
        az = az - (1 + gamma) * c33 * zd - (1 + beta) * k33 * z
        sensed = k_sr * (M_S @ psid) + k_s * zd * (1.0 + t_x * np.array([1.0, -1.0]))
        if effect == "sense_nonlinearity":
            sensed = sensed / (1.0 - p[0] * (M_S @ psi + z)) ** 2
        if effect == "gain_drift":
            sensed = sensed * (1.0 + p[0] * t)
        if effect == "resistive_feedthrough":
            sensed = sensed + np.reshape(p, (2, 2)) @ volts
        if effect == "capacitive_feedthrough":
            sensed = sensed + np.reshape(p, (2, 2)) @ slope
        if effect == "pickoff_crosstalk":
            sensed = np.array([[1.0, p[0]], [p[1], 1.0]]) @ sensed
        out = np.empty_like(y)
        out[:2], out[2], out[3:5], out[5] = psid, zd, a, az
        at = 6
        if slow:
            out[6:8], sensed, at = (sensed - y[6:8]) / p[0], y[6:8], 8
        for w, b in sections:
            x0, x1 = y[at : at + 2], y[at + 2 : at + 4]
            out[at : at + 2], out[at + 2 : at + 4] = w * x1, w * (sensed - x0) - b * x1
            sensed, at = x0, at + 4
        return out

    y = np.zeros(6 + slow + 4 * len(sections))
    step = 1.0 / RATE
    record = np.zeros((v.shape[0], 2))
    before = np.zeros(2)
    for n in range(v.shape[0]):
        record[n] = y[-4:-2]
        if n + 1 == v.shape[0]:
            break
        slope = (v[n + 1] - v[n]) / step if first_order else np.zeros(2)
        if effect == "capacitive_feedthrough" and (n == 0 or not first_order):
            y[8:10] += sections[0][0] * (np.reshape(p, (2, 2)) @ (v[n] - before))
            before = v[n]
        t0 = n * step
        solver = DOP853(
            lambda t, y, n=n, slope=slope, t0=t0: motion(t, y, v[n], slope, t0),
            t0,
            y,
            t0 + step,
            rtol=1e-10,
            atol=1e-13,
            first_step=step / 4.0,
        )
        while solver.status == "running":
            solver.step()
        y = solver.y.copy()
    return record


STRONG: dict[str, list[float]] = {
    "nonlinear_damping": [200.0],
    "damping_drift": [9.0],
    "frequency_drift": [0.09],
    "cubic_stiffness": [3e12],
    "quadratic_stiffness": [1e10, -1e10],
    "electrostatic_softening": [800.0],
    "sense_nonlinearity": [800.0],
    "gain_drift": [0.9],
    "offdiagonal_damping": [0.4],
    "angular_rate": [3.0],
    "updown_tilt": [0.2],
    "electrode_misalignment": [5.0],
    "electrode_mismatch": [0.1, -0.05],
    "drive_nonlinearity": [1.0],
    "resistive_feedthrough": [0.1, 0.02, -0.03, 0.05],
    "capacitive_feedthrough": [1e-5, 2e-5, -1e-5, 3e-5],
    "pickoff_crosstalk": [0.1, 0.03],
    "pickoff_pole": [3e-5],
}


@pytest.mark.parametrize(
    ("name", "hold"),
    [(name, "zoh") for name in STRONG]
    + [(name, "foh") for name in ("electrostatic_softening", "capacitive_feedthrough", "pickoff_pole")],
)
def test_strong_effects_agree_with_dop853_to_a_millionth_of_the_signal(name: str, hold: Any) -> None:
    record = _record(90)
    model = DEFAULT_COMPARE_MODEL.with_effect(name)
    effect = model.effect(name)
    values = {effect.full_name(m): value for m, value in zip(effect.members(model.built.shape), STRONG[name])}
    found = forward(model, {**PLANT, **values}, record, replace(INSTRUMENT, hold=hold))
    expected = _oracle(name, STRONG[name], record.drive_v, hold == "foh")
    assert np.max(np.abs(found - expected)) < 1e-6 * np.max(np.abs(expected))


@pytest.mark.parametrize("quarters", [1, 3, 4, 6])
@pytest.mark.parametrize("with_law", [False, True])
def test_a_delay_shifts_the_record_computed_at_a_higher_sample_rate(quarters: int, with_law: bool) -> None:
    record = _record(400)
    model, values = DEFAULT_COMPARE_MODEL, dict(PLANT)
    if with_law:
        model, values = model.with_effect("sense_nonlinearity"), {**values, "sense_nonlinearity.1/g": 100.0}
    fine = Record("fine", 4 * RATE, np.repeat(record.drive_v, 4, axis=0), np.zeros((1600, 2)))
    late = np.zeros((1600, 2))
    late[quarters:] = forward(model, values, fine, INSTRUMENT)[:-quarters]
    found = forward(
        model.with_effect("loop_delay"), {**values, "loop_delay.tau": quarters / (4.0 * RATE)}, record, INSTRUMENT
    )
    assert np.max(np.abs(found - late[::4])[:-1]) < (1e-8 if with_law else 1e-11) * np.max(np.abs(found))


def test_a_parasitic_mode_adds_the_response_of_its_own_resonator() -> None:
    record = _record(2000)
    f, zeta, angle, b = 900.0, 2e-3, 30.0, (0.3, -0.2)
    model = DEFAULT_COMPARE_MODEL.with_effect("parasitic_mode")
    own = {"f": f, "zeta": zeta, "a": angle, "b_d1": b[0], "b_d2": b[1]}
    both = forward(model, {**PLANT, **{f"parasitic_mode.{k}": x for k, x in own.items()}}, record, INSTRUMENT)
    alone = Model(PlantSpec("modal", 1, "velocity", 2, 2))
    vector = (np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle)))
    gains = {f"gain1_s{s + 1}d{d + 1}": vector[s] * b[d] for s in range(2) for d in range(2)}
    added = forward(alone, {"f1_hz": f, "zeta1": zeta, **gains}, record, INSTRUMENT)
    plain = forward(DEFAULT_COMPARE_MODEL, PLANT, record, INSTRUMENT)
    assert np.max(np.abs(both - plain - added)) < 1e-11 * np.max(np.abs(both))


def test_saturation_only_clips_the_samples() -> None:
    record = _record(1000)
    plain = forward(DEFAULT_COMPARE_MODEL, PLANT, record, INSTRUMENT)
    level = 0.7 * np.max(np.abs(plain))
    model = DEFAULT_COMPARE_MODEL.with_effect("adc_saturation")
    found = forward(model, {**PLANT, "adc_saturation.1/level": 1.0 / level}, record, INSTRUMENT)
    assert np.array_equal(found, np.clip(plain, -1.0 / (1.0 / level), 1.0 / (1.0 / level)))


def test_the_column_of_the_clip_level_is_exact_for_every_sample() -> None:
    # dy/d(1/L) = -L^2 sign(y) where |y| > L, else 0: a sample just below the level does not follow it.
    record = _record(1000)
    plain = forward(DEFAULT_COMPARE_MODEL, PLANT, record, INSTRUMENT)
    model = DEFAULT_COMPARE_MODEL.with_effect("adc_saturation")
    level = 0.7 * float(np.max(np.abs(plain)))
    values = {**PLANT, "adc_saturation.1/level": 1.0 / level}
    column = jacobian(model, values, record, INSTRUMENT)[..., model.free.index("adc_saturation.1/level")]
    expected = np.where(np.abs(plain) > level, -(level**2) * np.sign(plain), 0.0)
    assert np.max(np.abs(column - expected)) < 1e-6 * level**2


def test_a_declared_rate_acts_without_the_effect_and_overrides_it() -> None:
    declared, unknown = _record(1000, rate_dps=200.0), _record(1000)
    kappa = 0.7
    model = DEFAULT_COMPARE_MODEL.with_effect("angular_rate")
    omega = kappa * np.deg2rad(200.0)
    by_effect = forward(model, {**PLANT, "angular_rate.Omega": omega}, unknown, INSTRUMENT)
    by_declaration = forward(DEFAULT_COMPARE_MODEL, PLANT, declared, INSTRUMENT, angular_gain=kappa)
    overruled = forward(model, {**PLANT, "angular_rate.Omega": 9.0}, declared, INSTRUMENT, angular_gain=kappa)
    assert np.array_equal(by_effect, by_declaration)
    assert np.array_equal(by_effect, overruled)


@pytest.mark.parametrize("effects", [("gain_drift", "loop_delay"), ("cubic_stiffness", "pickoff_crosstalk")])
def test_the_jacobian_is_the_derivative_of_the_forward_model(effects: tuple[str, ...]) -> None:
    record = _record(600)
    model = replace(SCREENING_MODEL, effects=("offdiagonal_damping", *effects))
    values = {**PLANT, "c12_per_s": 0.2}
    sizes = {
        "gain_drift.gamma": 0.05,
        "loop_delay.tau": 1.3e-5,
        "cubic_stiffness.k3": 1e11,
        "pickoff_crosstalk.a": 0.05,
    }
    values |= {name: value for name, value in sizes.items() if name in model.by_name}
    x = model.to_internal(model.complete(values))
    columns = jacobian(model, values, record, INSTRUMENT, exact=True)
    for i in range(x.size):
        step = 20.0 * model.steps(x)[i]
        up, down = x.copy(), x.copy()
        up[i], down[i] = x[i] + step, x[i] - step
        slope = forward(model, model.to_values(up), record, INSTRUMENT)
        slope = (slope - forward(model, model.to_values(down), record, INSTRUMENT)) / (2.0 * step)
        assert np.linalg.norm(columns[:, :, i] - slope) < 1e-3 * np.linalg.norm(slope)


def test_parameters_that_are_not_identifiable_at_the_null_are_scanned() -> None:
    record = _record(300)
    group = drive_group_of([record], INSTRUMENT, None)
    grid = {"f": (700.0, 900.0), "zeta": (1e-2,), "a": (0.0, 90.0)}
    found = list(signatures(base_of(DEFAULT_COMPARE_MODEL, PLANT, group, INSTRUMENT), "parasitic_mode", grid=grid))
    assert [(s.point["f"], s.point["a"]) for s in found] == [(700.0, 0.0), (700.0, 90.0), (900.0, 0.0), (900.0, 90.0)]
    assert all(s.names == ("b_d1", "b_d2") for s in found)
    # A mode that only sense 1 measures does not change sense 2.
    columns = found[0].columns
    assert np.max(np.abs(columns[..., 1])) < 1e-12 * np.max(np.abs(columns[..., 0]))


def test_impossible_parameters_and_wrong_channels_raise_typed_errors() -> None:
    record = _record(100)
    with pytest.raises(ConfigError, match="damping matrix has a negative eigenvalue"):
        forward(SCREENING_MODEL, {**PLANT, "c12_per_s": 5.0}, record, INSTRUMENT)
    with pytest.raises(ConfigError, match="missing"):
        forward(DEFAULT_COMPARE_MODEL, {"f1_hz": 534.5}, record, INSTRUMENT)
    with pytest.raises(MeasurementError, match="different numbers of drives"):
        forward(Model(PlantSpec("modal")), {}, record, INSTRUMENT)
    model = DEFAULT_COMPARE_MODEL.with_effect("cubic_stiffness")
    with pytest.raises(ConfigError, match="diverges"):
        forward(model, {**PLANT, "cubic_stiffness.k3": -1e15}, _record(600, 20.0), INSTRUMENT)
