"""Noise, temperature, pull-in and shock against calculations from the equations of motion."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm, solve_discrete_lyapunov
from scipy.optimize import brentq

from pipeline.arrays import FloatArray
from pipeline.device.gyro import M_D, PHYSICAL, gyro_mechanics
from pipeline.experiment.noise.spectrum import white_spectrum
from pipeline.experiment.systematic import Systematic
from pipeline.inference.estimate import RateSettings, quantities
from pipeline.inference.pickoff_noise import with_measured_noise
from pipeline.performance.figures.shock_limit_g import half_sine_peak
from pipeline.performance.operating_point import DeclaredOperation

DECLARED = DeclaredOperation(
    drive_amplitude_v=1.0,
    pickoff_noise_v=2e-6,
    softening_hz_per_v2=-0.03,
    gap_um=10.0,
    mass_mg=50.0,
    temperature_c=25.0,
    damping_ppm_per_c=1300.0,
    shock_ms=0.5,
)
RATE = RateSettings(0.7, 1.0, "f1", Systematic(tcf_ppm_per_c=-28.0), DECLARED, 5.0)


@pytest.fixture
def paper_device() -> FloatArray:
    return np.array([534.5, 536.4, 590.3, 3.167e-4, 1.586e-4, 11.7e-4, -33.0, 0.05, 13.3, 28.6, 0.037, 0.0007])


def values(device: FloatArray, rate: RateSettings = RATE) -> dict[str, float]:
    return {name: float(value[0]) for name, value in quantities(device[None], rate).items()}


def test_the_thermal_random_walk_is_that_of_a_simulated_brownian_motion():
    """m y'' + m c y' + m omega_s^2 y = white force of density 2 k_B T m c, demodulated as the rate is, and integrated."""
    f0, split, q = 200.0, 3.0, 60.0
    device = np.array([f0, f0 + split, 250.0, 0.5 / q, 0.5 / q, 1e-3, 20.0, 0.0, 13.3, 28.6, 0.0, 0.0])
    found = values(device)
    omega0, omega, c = 2.0 * np.pi * f0, 2.0 * np.pi * (f0 + split), 2.0 * np.pi * (f0 + split) / q
    mass, energy = 50e-6, 1.380649e-23 * 298.15
    # The gap in V s, from the softening: 2 G_r V_b / g = -d(omega^2) with d f = -0.03 V_b^2.
    gap = 2.0 * 13.3 * 5.0 / (2.0 * omega0 * 2.0 * np.pi * 0.03 * 25.0)
    velocity = 0.5 * 10e-6 / gap

    step, count, devices = 1.0 / 4000.0, 8000, 1200
    transition = expm(np.array([[0.0, 1.0], [-(omega**2), -c]]) * step)
    stationary = np.diag([energy / (mass * omega**2), energy / mass])
    kick = np.linalg.cholesky(stationary - transition @ stationary @ transition.T)
    assert solve_discrete_lyapunov(transition, kick @ kick.T) == pytest.approx(stationary, rel=1e-6)
    random = np.random.default_rng(3)
    y = np.linalg.cholesky(stationary) @ random.standard_normal((2, devices))
    # Velocity per rate at omega0; a rate is demodulated in the phase in which a constant one appears.
    per_rate = 2.0 * 0.7 * velocity * 1j * omega0 / (omega**2 - omega0**2 + 1j * omega0 * c)
    shape = 2.0 * np.exp(-1j * omega0 * step * np.arange(count)) / per_rate
    angle = np.zeros(devices)
    for turn in shape:
        y = transition @ y + kick @ random.standard_normal((2, devices))
        angle += (y[1] * turn).real * step
    walk = np.sqrt(np.mean(angle**2) / (count * step)) * 60.0 * np.degrees(1.0)
    # The sd of an rms of 1200 angles is 2 %; the ends of 2 s weigh 1 / (c T) = 2 %.
    assert walk == pytest.approx(found["arw_thermal_deg_per_rth"], rel=0.08)


def test_electronic_noise_walks_as_simulated_volts_do(paper_device):
    found = values(paper_device)
    step, devices, seconds = 1e-4, 400, 0.5
    t = step * np.arange(round(seconds / step))
    # White noise of density e^2 has the variance e^2 f_s / 2 per sample; the blend of two pick-offs twice that.
    sigma = 2e-6 / np.sqrt(2.0 * step)
    volts = sigma * np.sqrt(2.0) * np.random.default_rng(5).standard_normal((devices, t.size))
    angle = step * volts @ (2.0 * np.cos(2.0 * np.pi * 534.5 * t)) / found["scale_factor_v_per_dps"]
    walk = np.sqrt(np.mean(angle**2) / seconds) * 60.0
    assert walk == pytest.approx(found["arw_electronic_deg_per_rth"], rel=0.14)  # four sds of 400 angles
    both = np.hypot(found["arw_electronic_deg_per_rth"], found["arw_thermal_deg_per_rth"])
    assert found["arw_deg_per_rth"] == pytest.approx(both)


def test_noise_that_is_not_declared_is_that_of_the_silence_with_its_uncertainty():
    silent = replace(RATE, operation=replace(DECLARED, pickoff_noise_v=None))
    noise = white_spectrum(np.array([1e-3, 1e-3]), 10_000.0, 800)
    measured = with_measured_noise(silent, noise, 535.0, 2000).operation.pickoff_noise_v
    assert np.median(measured) == pytest.approx(1e-3 * np.sqrt(2.0 / 10_000.0), rel=1e-3)
    assert np.std(np.log(measured)) == pytest.approx(0.5 * np.sqrt(2.0 / 800.0) / np.sqrt(2.0), rel=0.01)
    assert with_measured_noise(RATE, noise, 535.0, 2000) is RATE


def test_the_bias_drifts_as_that_of_a_warmer_device(paper_device):
    warm = paper_device.copy()
    kelvin = 0.01
    for name in ("f1_hz", "f2_hz"):
        warm[PHYSICAL.index(name)] *= 1.0 - 28e-6 * kelvin
    for name in ("zeta1", "zeta2"):
        warm[PHYSICAL.index(name)] *= (1.0 + 1300e-6 * kelvin) / (1.0 - 28e-6 * kelvin)
    warm[PHYSICAL.index("c12_per_s")] *= 1.0 + 1300e-6 * kelvin
    drift = (values(warm)["rate_bias_dps"] - values(paper_device)["rate_bias_dps"]) / kelvin
    assert values(paper_device)["rate_bias_dps_per_c"] == pytest.approx(drift, rel=1e-6)


#: The figures take both electrodes to move alike; the axes turned by -33 deg tilt them by the relative split, 3.6e-3.
@pytest.mark.parametrize(("theta_deg", "tolerance"), [(0.0, 2e-4), (-33.0, 4e-3)])
def test_pull_in_and_shock_are_the_folds_of_the_three_coupled_modes(paper_device, theta_deg, tolerance):
    """The law of electrostatic_softening at any bias: y_k = motion of electrode k over g = row k of  C (P - V_b/2) + a c."""
    paper_device[6], paper_device[11] = theta_deg, 0.0
    found = values(paper_device)
    gap = paper_device[8] / (4.0 * np.pi**2 * 0.5 * (paper_device[0] + paper_device[1]) * 0.03 * 5.0)
    mechanics, motion = gyro_mechanics(paper_device[None]), np.vstack([M_D, np.ones(2)]).T
    drive = mechanics.drive[0]
    springs = mechanics.stiffness[0] + 5.0 / gap * drive @ motion
    by_pull = motion @ np.linalg.solve(springs, drive) / gap
    by_shock = motion @ np.linalg.solve(springs, np.array([0.0, 0.0, 1.0])) / gap

    def along(y1: float, bias: float | None) -> float:
        """The bias, or the acceleration at that bias, at which electrode 1 rests at y1."""

        def load(y2: float) -> tuple[float, float]:
            """The load that holds y1, and by how much y2 is then missed."""
            y = np.array([y1, y2])
            pull = by_pull / (1.0 - y) ** 2
            fixed = by_pull @ np.full(2, -2.5) + (0.0 if bias is None else pull @ np.full(2, bias**2 / 10.0))
            per_load = pull.sum(axis=1) if bias is None else by_shock
            held = (y1 - fixed[0]) / per_load[0]
            return held, y2 - fixed[1] - held * per_load[1]

        held = load(brentq(lambda y2: load(y2)[1], y1 - 0.02, y1 + 0.02))[0]
        return np.sqrt(10.0 * held) if bias is None else held

    path = np.linspace(0.2, 0.5, 121)
    assert found["pull_in_margin"] == pytest.approx(max(along(y1, None) for y1 in path) / 5.0, rel=tolerance)
    static = max(along(y1, 5.0) for y1 in np.linspace(0.7, 0.84, 71)) * 10e-6 / gap / 9.80665
    peak = float(half_sine_peak(np.array(2.0 * np.pi * paper_device[2] * 0.5e-3 / np.pi)))
    assert found["shock_limit_g"] == pytest.approx(static / peak, rel=tolerance)


@pytest.mark.parametrize("r", [0.2, 0.9, 1.0, 1.7, 4.0, 9.3])
def test_the_peak_of_a_half_sine_is_that_of_the_integrated_mode(r):
    omega = r * np.pi  # a pulse of 1 s
    run = solve_ivp(
        lambda t, x: [x[1], (np.sin(np.pi * t) if t < 1.0 else 0.0) - omega**2 * x[0]],
        (0.0, 1.0 + 2.0 * np.pi / omega),
        [0.0, 0.0],
        max_step=0.01,
        rtol=1e-8,
    )
    assert float(half_sine_peak(np.array(r))) == pytest.approx(np.abs(run.y[0]).max() * omega**2, rel=2e-3)
