"""Common errors of a tester: laws by invariances of the response, P(conform) against its closed form."""

import numpy as np
import pytest
from scipy.stats import norm

from pipeline.device.gyro import PHYSICAL, gyro_modes, to_cartesian
from pipeline.experiment.excitation import Chirp, drive_samples
from pipeline.experiment.forward.modal_bank import respond
from pipeline.experiment.systematic import Systematic
from pipeline.inference.estimate import RateSettings, cartesian_quantities, intervals
from pipeline.inference.systematic import Identified, common_nodes, with_common_errors
from reports.decision import decide
from reports.limits import load_limits
from workflows.screening.judging import p_pass_given_common

PAPER = np.array([534.5, 536.4, 590.3, 3.167e-4, 1.586e-4, 11.7e-4, -33.2, 0.4, 13.33, 28.6, 0.0386, 0.0007])
COUNT, KAPPA, PHI = 3072, 0.7, 1.0
LIMITS = load_limits({"limits": {"rate_bias_dps": {"min": -20.0, "max": 20.0}}})


def identified(systematic: Systematic, sd: float = 0.0, physical: np.ndarray = PAPER) -> Identified:
    draws = np.tile(physical, (COUNT, 1)) * (1.0 + sd * np.random.default_rng(3).standard_normal((COUNT, 12)))
    return Identified.of_physical(draws, RateSettings(KAPPA, PHI, "f1", systematic))


def test_without_common_errors_the_draws_are_those_of_the_posterior_bit_by_bit():
    x = to_cartesian(PAPER * (1.0 + 1e-6 * np.random.default_rng(1).standard_normal((500, 12))))
    rate = RateSettings(KAPPA, PHI)
    for name, values in cartesian_quantities(x, rate).items():
        np.testing.assert_array_equal(Identified.of_cartesian(x, rate).draws[name], values)


def test_a_clock_error_is_a_scaling_of_time_that_the_samples_do_not_show():
    moved = identified(Systematic(clock_sd_ppm=100.0)).given(np.array([0.0, 0.0, 0.0, 3.0, 0.0]))
    device = np.array([moved[name][0] for name in PHYSICAL])
    drive = drive_samples(Chirp((400.0, 700.0), (700.0, 400.0), (2.0, 2.0), 0.5), 10_000.0)
    seen = respond(gyro_modes(device[None]), drive, 10_000.0 * (1.0 + 3e-4), "zoh")
    declared = respond(gyro_modes(PAPER[None]), drive, 10_000.0, "zoh")
    assert device[0] - PAPER[0] == pytest.approx(3e-4 * PAPER[0])
    np.testing.assert_allclose(seen, declared, atol=1e-9 * np.abs(declared).max())


def test_temperature_moves_frequencies_by_its_coefficient_and_keeps_damping_rates():
    moved = identified(Systematic(temperature_sd_c=2.0, tcf_ppm_per_c=-28.0)).given(np.array([0.0, 0.0, 0.0, 0.0, 1.0]))
    for name, i in (("f1_hz", 0), ("f3_hz", 2)):
        assert moved[name][0] == pytest.approx(PAPER[i] * (1.0 - 56e-6), rel=1e-12)
    assert (moved["zeta1"] * moved["f1_hz"])[0] == pytest.approx(PAPER[3] * PAPER[0], rel=1e-12)
    assert moved["theta_deg"][0] == PAPER[6]
    assert moved["c12_per_s"][0] == PAPER[7]


def test_p_conform_under_a_phase_error_is_its_closed_form():
    for sd_deg, phi_deg in ((0.3, 0.0), (0.5, 1.0), (2.0, 2.0)):
        rate = RateSettings(KAPPA, phi_deg, "f1", Systematic(phase_error_sd_deg=sd_deg))
        draws = Identified.of_physical(np.tile(PAPER, (COUNT, 1)), rate).draws
        p = decide(LIMITS, {"rate_bias_dps": draws["rate_bias_dps"][None]}, ["ok"]).p_pass[0]
        quadrature, inphase = draws["quadrature_rate_dps"][0], draws["inphase_bias_dps"][0]
        ends = np.rad2deg(np.arctan((np.array([-20.0, 20.0]) - inphase) / quadrature))
        low, high = np.sort((ends - phi_deg) / sd_deg)
        # The hypercube has one node in each of n strips of equal probability: an error of at most 1/n at each end.
        assert p == pytest.approx(norm.cdf(high) - norm.cdf(low), abs=2.0 / COUNT)


def test_sds_of_all_common_errors_add_in_squares_to_those_of_the_posterior():
    systematic = Systematic(0.5, 0.01, 0.02, 20.0, 1.5)
    both = intervals(identified(systematic, 1e-5).draws)
    alone = intervals(identified(Systematic(), 1e-5).draws)
    estimates = {name: (alone[name], alone[f"{name}_sd"]) for name in (*PHYSICAL, "split_hz")}
    for name, (_, sd) in with_common_errors(estimates, systematic).items():
        assert both[f"{name}_sd"] == pytest.approx(sd, rel=0.03)
    assert both["rocking_gain_sd"] / both["rocking_gain"] == pytest.approx(0.02, rel=0.03)
    assert both["f1_hz_sd"] / both["f1_hz"] == pytest.approx(1e-6 * np.hypot(20.0, 28.0 * 1.5) + 0.0, rel=0.06)
    assert both["theta_deg_sd"] == alone["theta_deg_sd"]


def test_a_common_error_gives_all_devices_the_same_shift_and_averages_to_p_conform():
    systematic = Systematic(phase_error_sd_deg=0.5)
    nodes = common_nodes(200)
    # Two devices on either side of theta = 0 have opposite quadrature: what fails one lets the other pass.
    other = PAPER * np.where(np.arange(12) == 6, -1.0, 1.0)
    near = [identified(systematic, 1e-6, device) for device in (PAPER, other)]
    limits = load_limits({"limits": {"quadrature_bias_dps": {"min": -7.8, "max": 7.8}}})
    given = [p_pass_given_common(limits, device, nodes) for device in near]
    np.testing.assert_allclose(given[0], given[1], atol=0.02)
    single = load_limits({"limits": {"quadrature_bias_dps": {"max": 0.0}}})
    signed = [p_pass_given_common(single, device, common_nodes(200)) for device in near]
    np.testing.assert_array_equal(signed[0] + signed[1], 1.0)
    for device, p in zip(near, given):
        draws = {"quadrature_bias_dps": device.draws["quadrature_bias_dps"][None]}
        assert np.mean(p) == pytest.approx(decide(limits, draws, ["ok"]).p_pass[0], abs=0.01)
