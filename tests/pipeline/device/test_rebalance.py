"""The simulated loops confirm the corrected equations (3) to (6), and contradict the printed ones by the stated factors."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from pipeline.device.gyro import gyro_mechanics
from pipeline.device.operation.bias import rate_biases_dps
from pipeline.device.operation.loops import Forced, Loops
from pipeline.device.operation.propagator import propagators
from pipeline.device.operation.rebalance import (
    indicated_rate_dps,
    measured_biases_dps,
    operate,
    output_rate_dps,
    self_oscillation_hz,
    settled,
)
from pipeline.device.operation.scale_factor import scale_factor
from pipeline.errors import ConfigError

COUNT = 50
TAU = 2.0 * np.pi


def random_devices(seed, count):
    """Splits 0.2 to 4 Hz, any theta, damping ratios that differ by a factor, c12 up to 0.9 of what passivity allows."""
    random = np.random.default_rng(seed)
    p = np.tile([0.0, 0.0, 590.3, 0.0, 0.0, 11.7e-4, 0.0, 0.0, 13.3, 28.6, 0.0, 0.0], (count, 1))
    p[:, 0] = random.uniform(525.0, 545.0, count)
    p[:, 1] = p[:, 0] + 0.2 * 20.0 ** random.uniform(size=count)
    p[:, 3:5] = 2e-4 * np.exp(random.normal(0.0, 0.5, (count, 2)))
    p[:, 6] = random.uniform(-90.0, 90.0, count)
    c = 2.0 * TAU * p[:, 3:5] * p[:, :2]
    p[:, 7] = random.uniform(-0.9, 0.9, count) * np.sqrt(c.prod(axis=1))
    return p, random.uniform(0.3, 0.9, count), random.uniform(-3.0, 3.0, count)


@pytest.fixture(scope="module")
def bench():
    """50 devices: parameters, kappa, phi, the stiffness and damping terms of (3) and (4), and the loops at rest."""
    p, kappa, phi = random_devices(20, COUNT)
    omega, double = TAU * p[:, :2], np.deg2rad(2.0 * p[:, 6])
    c11, c22 = 2.0 * p[:, 3] * omega[:, 0], 2.0 * p[:, 4] * omega[:, 1]
    terms = {
        "k_xy": 0.5 * (omega[:, 0] ** 2 - omega[:, 1] ** 2) * np.sin(double),
        "anisotropic": 0.5 * (c11 - c22) * np.sin(double),
        "offdiagonal": p[:, 7] * np.cos(double),
        "c_yy": 0.5 * (c11 + c22) - 0.5 * (c11 - c22) * np.cos(double) + p[:, 7] * np.sin(double),
        "damping": c11 + c22,
        "splitting": omega[:, 1] ** 2 - omega[:, 0] ** 2,
    }
    return p, kappa, phi, terms, settled(operate(p, kappa))


def test_the_drive_axis_has_the_frequency_and_damping_of_equation_3(bench):
    p, _, _, terms, rest = bench
    np.testing.assert_allclose(rest.amplitude_v, 1.0, rtol=1e-8)
    np.testing.assert_allclose(rest.frequency_hz, self_oscillation_hz(p), rtol=1e-10)
    np.testing.assert_allclose(rest.damping_per_s / terms["damping"], terms["c_yy"] / terms["damping"], atol=1e-6)


def test_rebalance_torque_is_the_corrected_equation_4(bench):
    _, _, _, terms, rest = bench
    quadrature = -terms["k_xy"] / (TAU * rest.frequency_hz)
    scale = terms["splitting"] / (TAU * rest.frequency_hz)
    assert np.max(np.abs(rest.quadrature_per_s - quadrature) / scale) < 1e-6
    inphase = terms["anisotropic"] + terms["offdiagonal"]
    assert np.max(np.abs(rest.inphase_per_s - inphase) / terms["damping"]) < 1e-6


def test_biases_at_rest_are_those_of_the_formulas_to_1_percent(bench):
    p, kappa, phi, terms, rest = bench
    for i in range(COUNT):
        measured = {k: v[i] for k, v in measured_biases_dps(rest, kappa, phi).items()}
        # Measured at the loop's own omega0; the formula's convention f1 or f2 is off by less than the relative split.
        for drive in ("f1", "f2"):
            expected = rate_biases_dps(p[i], kappa[i], phi[i], drive)
            quadrature = np.rad2deg(terms["splitting"][i] / (4.0 * kappa[i] * TAU * p[i, 0]))
            natural = {
                "quadrature_rate_dps": quadrature,
                "quadrature_bias_dps": quadrature * np.tan(np.deg2rad(abs(phi[i]))),
                "inphase_bias_dps": np.rad2deg(terms["damping"][i] / (4.0 * kappa[i])),
            }
            assert abs(measured["rate_bias_dps"] - expected["rate_bias_dps"]) < 0.01 * (
                natural["quadrature_bias_dps"] + natural["inphase_bias_dps"]
            )
            for name, scale in natural.items():
                assert abs(measured[name] - expected[name]) < 0.01 * scale


def test_the_loop_runs_between_f1_and_f2_and_changes_the_quadrature_rate_by_less_than_the_relative_split(bench):
    p, kappa, _, _, rest = bench
    assert np.all((rest.frequency_hz >= p[:, 0] - 1e-7) & (rest.frequency_hz <= p[:, 1] + 1e-7))
    measured = measured_biases_dps(rest, kappa, 1.0)["quadrature_rate_dps"]
    expected = rate_biases_dps(p, kappa, 1.0, "f1")["quadrature_rate_dps"]
    shift = np.abs(measured / expected - 1.0)
    np.testing.assert_allclose(shift, 1.0 - p[:, 0] / rest.frequency_hz, atol=1e-6)
    assert np.max(shift) < 4.0 / 525.0


def test_a_drive_forced_to_f1_gives_the_quadrature_rate_of_the_convention(bench):
    p, kappa, _, _, _ = bench
    forced = settled(operate(p[:10], kappa[:10], drive=Forced(p[:10, 0])))
    np.testing.assert_allclose(forced.frequency_hz, p[:10, 0], rtol=1e-12)
    measured = measured_biases_dps(forced, kappa[:10], 2.0)
    expected = rate_biases_dps(p[:10], kappa[:10], 2.0, "f1")
    for name in expected:
        np.testing.assert_allclose(measured[name], expected[name], rtol=1e-5, atol=1e-4)


def test_rate_enters_with_the_factor_two_that_equation_5_omits(bench):
    p, kappa, phi, _, rest = bench
    rate = 40.0
    turning = settled(operate(p, kappa, rate))
    change = turning.inphase_per_s - rest.inphase_per_s
    np.testing.assert_allclose(change, -2.0 * kappa * np.deg2rad(rate), rtol=1e-6)
    np.testing.assert_allclose(turning.quadrature_per_s, rest.quadrature_per_s, atol=1e-6)
    shown = indicated_rate_dps(turning.inphase_per_s, turning.quadrature_per_s, kappa, phi)
    np.testing.assert_allclose(shown - measured_biases_dps(rest, kappa, phi)["rate_bias_dps"], rate, rtol=1e-6)
    printed = -kappa * np.deg2rad(rate)
    np.testing.assert_allclose(change / printed, 2.0, rtol=1e-6)


def test_the_loops_confirm_c12_cos_2theta_and_contradict_the_printed_half_of_it(bench):
    _, _, _, terms, rest = bench

    def wrong(inphase):
        return np.abs(rest.inphase_per_s - inphase) / terms["damping"] > 0.01

    assert not np.any(wrong(terms["anisotropic"] + terms["offdiagonal"]))
    assert np.count_nonzero(wrong(terms["anisotropic"] + 0.5 * terms["offdiagonal"])) > 0.8 * COUNT
    # By exactly the half that is missing.
    missing = rest.inphase_per_s - (terms["anisotropic"] + 0.5 * terms["offdiagonal"])
    assert np.max(np.abs(missing - 0.5 * terms["offdiagonal"]) / terms["damping"]) < 1e-6


def test_the_demodulated_output_is_proportional_to_half_the_squared_amplitude(bench):
    p, kappa, phi, terms, _ = bench
    amplitude, rate = 3.0, 25.0
    last = operate(p, kappa, rate, loops=Loops(amplitude_v=amplitude), waveform_s=0.3).waveforms
    omega0 = TAU * self_oscillation_hz(p)
    damping = (
        terms["anisotropic"] + terms["offdiagonal"] - 2.0 * kappa * np.deg2rad(rate)
    )  # the coefficient of psi_y' in (4)
    tilt = np.deg2rad(phi)
    bracket = -terms["k_xy"] / omega0 * np.sin(tilt) + damping * np.cos(tilt)
    # Multiply and average, as the paper does; the window takes out the ripple at twice the frequency.
    product = last.torque[:, :, 0] * amplitude * np.cos(last.phase + tilt[:, None])
    window = np.blackman(product.shape[1])
    shown = product @ window / window.sum()
    scale = np.hypot(terms["k_xy"] / omega0, damping)
    assert np.max(np.abs(shown / (amplitude**2 / 2.0) - bracket) / scale) < 1e-4
    printed = amplitude / 2.0 * bracket
    np.testing.assert_allclose(shown / printed, amplitude, atol=1e-3 * np.max(scale / np.abs(bracket)))
    # And sample by sample: tau_x is the linear combination (4) of psi_y and psi_y'.
    for i in range(COUNT):
        motion = np.stack([last.position[i, :, 1], last.velocity[i, :, 1]], axis=1)
        found = np.linalg.lstsq(motion, last.torque[i, :, 0], rcond=None)[0]
        assert abs(found[0] - terms["k_xy"][i]) < 1e-5 * terms["splitting"][i]
        assert abs(found[1] - damping[i]) < 1e-5 * terms["splitting"][i] / omega0[i]


def test_the_scale_factor_is_one_and_its_offset_is_the_bias(bench):
    p, kappa, phi, _, rest = bench
    found = scale_factor(p[:4], kappa[:4], np.array([-100.0, -10.0, 30.0, 100.0]), phi[:4])
    np.testing.assert_allclose(found.slope, 1.0, rtol=1e-6)
    bias = measured_biases_dps(rest, kappa, phi)["rate_bias_dps"][:4]
    np.testing.assert_allclose(found.offset_dps, bias, atol=1e-4)
    assert np.max(found.nonlinearity_dps) < 1e-4


def test_a_direct_high_gain_loop_tends_to_the_ideal_torque_as_one_over_its_gain(bench):
    p, kappa, _, _, rest = bench
    errors = []
    for gain in (2e4, 4e4):
        found = settled(operate(p[:8], kappa[:8], loops=Loops(rebalance_hz=0.0, direct_per_s=gain), duration_s=2.0))
        miss = found.inphase_per_s - rest.inphase_per_s[:8] + 1j * (found.quadrature_per_s - rest.quadrature_per_s[:8])
        errors.append(np.abs(miss) / np.hypot(rest.inphase_per_s, rest.quadrature_per_s)[:8])
    assert np.max(errors[0]) < 0.01
    np.testing.assert_allclose(errors[0] / errors[1], 2.0, rtol=0.02)


def test_only_the_rebalance_loop_holds_psi_x_at_zero(bench):
    p, kappa, _, _, _ = bench
    held = operate(p[:5], kappa[:5])
    free = operate(p[:5], kappa[:5], loops=Loops(rebalance_hz=0.0))
    assert np.max(np.abs(held.sense_velocity[:, -1])) < 1e-8
    assert np.min(np.abs(free.sense_velocity[:, -1])) > 0.1


def test_the_output_follows_a_slow_rate(bench):
    p, kappa, _, _, rest = bench
    time = np.arange(40_000) / 20_000.0
    rate = 20.0 * np.sin(TAU * 0.5 * time)
    run = operate(p[:3], kappa[:3], rate, duration_s=2.0)
    shown = output_rate_dps(run, kappa[:3], 1.0) - measured_biases_dps(rest, kappa, 1.0)["rate_bias_dps"][:3, None]
    late = run.time_s > 1.0
    # The loops lag by less than 1 / (2 pi 5 Hz) + 1 / (2 pi 50 Hz), so 35 ms of 63 deg/s^2 at most.
    assert np.max(np.abs(shown - run.rate_dps)[:, late]) < 0.035 * 20.0 * TAU * 0.5


def test_propagator_is_the_matrix_exponential_at_any_rate_and_detuning():
    mechanics = gyro_mechanics(random_devices(3, 1)[0])
    damping, stiffness = mechanics.damping[:, :2, :2], mechanics.stiffness[:, :2, :2]
    carrier, step = TAU * 535.0, 5e-5
    steps = propagators(damping, stiffness, np.array([carrier]), step)[0]
    for a, b in ((0.0, 0.0), (3.0, 0.0), (0.0, 20.0), (-8.0, 15.0)):
        whole = np.zeros((8, 8))
        whole[:2, 2:4] = whole[2:4, 4:6] = np.eye(2)
        whole[2:4, :2] = -stiffness[0]
        whole[2:4, 2:4] = -damping[0] - a * np.array([[0.0, -1.0], [1.0, 0.0]])
        whole[4:6, 6:8], whole[6:8, 4:6] = -(carrier + b) * np.eye(2), (carrier + b) * np.eye(2)
        found = np.einsum("m,mij->ij", [1.0, a, b, a * a, a * b, b * b], steps)
        exact = expm(whole * step)[:4]
        scale = np.abs(expm(whole * step))[:4].max(axis=1, keepdims=True)
        assert np.max(np.abs(found - exact) / scale) < 1e-9


def analogue_envelopes(p, kappa, rate_at, loops, times):
    """The loops as one system of ordinary differential equations: no propagator, no samples, no shared code."""
    m = gyro_mechanics(p[None])
    c, k = m.damping[0, :2, :2], m.stiffness[0, :2, :2]
    b, r = TAU * loops.drive_hz, TAU * loops.rebalance_hz
    g, out, amplitude = TAU * loops.demodulator_hz, TAU * loops.output_hz, loops.amplitude_v
    carrier = np.pi * (p[0] + p[1])

    def slope(t, y):
        psi, velocity, phase, sum_phase = y[:2], y[2:4], y[4], y[5]
        v_x, v_y, sum_x, sum_y = y[6] + 1j * y[7], y[8] + 1j * y[9], y[10] + 1j * y[11], y[12]
        shown = y[13] + 1j * y[14]
        rotation = np.exp(1j * phase)
        t_y = 2.0 * b * (amplitude - v_y.real + sum_y)
        t_x = -2.0 * r * (v_x + sum_x)
        tau = np.array([(t_x * rotation).real, (t_y * rotation).real])
        coriolis = 2.0 * kappa * np.deg2rad(rate_at(t)) * np.array([-velocity[1], velocity[0]])
        acceleration = tau - coriolis - c @ velocity - k @ psi
        d_x = 2.0 * g * (velocity[0] - (v_x * rotation).real) / rotation
        d_y = 2.0 * g * (velocity[1] - (v_y * rotation).real) / rotation
        omega = carrier + b * (v_y.imag / amplitude + sum_phase)
        e = 0.25 * r * v_x
        d_out = 2.0 * out * (tau[0] - (shown * rotation).real) / rotation
        return np.array(
            [
                *(*velocity, *acceleration, omega, 0.25 * b * v_y.imag / amplitude),
                *(d_x.real, d_x.imag, d_y.real, d_y.imag),
                *(e.real, e.imag, 0.25 * b * (amplitude - v_y.real), d_out.real, d_out.imag),
            ]
        )

    found = solve_ivp(slope, (0.0, times[-1]), np.zeros(15), "DOP853", times, rtol=1e-9, atol=1e-12)
    y = found.y
    v_x, v_y = y[6] + 1j * y[7], y[8] + 1j * y[9]
    t_y = 2.0 * b * (amplitude - v_y.real + y[12])
    return v_y, v_x, t_y, y[13] + 1j * y[14], (carrier + b * (v_y.imag / amplitude + y[5])) / TAU


def test_closed_loops_agree_with_dop853_on_the_continuous_loops_under_a_changing_rate():
    p, kappa, _ = random_devices(8, 1)
    loops = Loops(amplitude_v=0.7, drive_hz=20.0, rebalance_hz=20.0)
    duration = 0.25

    def rate_at(t):
        return 200.0 * np.sin(TAU * 6.0 * t)

    runs = []
    for sample_rate in (160_000.0, 320_000.0):
        time = np.arange(round(duration * sample_rate)) / sample_rate
        run = operate(p, kappa, rate_at(time), loops=loops, duration_s=duration, sample_rate_hz=sample_rate)
        envelopes = (run.drive_velocity, run.sense_velocity, run.drive_torque, run.rebalance_torque, run.frequency_hz)
        runs.append([one[0] for one in envelopes])
        times = run.time_s
    for k, exact in enumerate(analogue_envelopes(p[0], float(kappa[0]), rate_at, loops, times)):
        # The sampled controller acts a step late: first order in the step, which extrapolation takes out.
        extrapolated = 2.0 * runs[1][k] - runs[0][k]
        scale = np.max(np.abs(exact - exact[-1]))
        assert np.max(np.abs(extrapolated - exact)) < 1e-4 * scale
        assert np.max(np.abs(runs[1][k] - exact)) > np.max(np.abs(extrapolated - exact))


def test_settled_refuses_loops_that_have_not_settled(bench):
    p, kappa, _, _, _ = bench
    with pytest.raises(ConfigError, match="not settled"):
        settled(operate(p[:1], kappa[:1], duration_s=0.15))
    rate = 50.0 * np.sin(TAU * 2.0 * np.arange(30_000) / 20_000.0)
    with pytest.raises(ConfigError, match="not settled"):
        settled(operate(p[:1], kappa[:1], rate))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"sample_rate_hz": 5_000.0}, "too few controller samples"),
        ({"angular_gain": 0.0}, "angular gain"),
        ({"rate_dps": np.zeros(7)}, "rate does not fit"),
        ({"rate_dps": np.zeros((3, 1))}, "rate does not fit"),
        ({"loops": Loops(demodulator_hz=9_000.0)}, "are unstable"),
    ],
)
def test_an_impossible_run_is_a_config_error(arguments, message):
    p, _, _ = random_devices(1, 1)
    call = {"physical": p, "angular_gain": 0.7, "duration_s": 0.1} | arguments
    with pytest.raises(ConfigError, match=message):
        operate(**call)


def test_loops_faster_than_their_demodulators_are_refused():
    with pytest.raises(ConfigError, match="too fast"):
        Loops(rebalance_hz=60.0)
