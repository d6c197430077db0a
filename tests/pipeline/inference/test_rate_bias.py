"""Rate bias from posterior draws: median against simulated loops, sd against propagated uncertainties."""

import numpy as np
import pytest

from pipeline.device.operation.bias import rate_biases_dps
from pipeline.device.operation.rebalance import measured_biases_dps, operate, settled
from pipeline.device.operation.trim import Target, trim
from pipeline.device.operation.trim_electrodes import standard_electrodes
from pipeline.errors import ConfigError
from pipeline.inference.estimate import RateSettings, intervals, quantities
from pipeline.inference.rate_bias import bias_draws, bias_from_posterior

PAPER = np.array([534.5, 536.4, 590.3, 3.167e-4, 1.586e-4, 11.7e-4, -33.2, 0.4, 13.33, 28.6, 0.0386, 0.0007])
KAPPA, PHI = 0.7, 1.0
COUNT = 20_000


def test_the_median_bias_is_that_of_the_simulated_loops():
    found = bias_from_posterior(np.tile(PAPER, (10, 1)), (KAPPA, 0.0), (PHI, 0.0), np.random.default_rng(0))
    shown = measured_biases_dps(settled(operate(PAPER[None], KAPPA)), KAPPA, PHI)
    for name, value in shown.items():
        assert found[name] == pytest.approx(value[0], abs=1e-4)
        assert found[f"{name}_sd"] == pytest.approx(0.0, abs=1e-9)


def test_uncertainty_of_damping_and_phase_propagates_to_the_bias():
    random = np.random.default_rng(4)
    draws = np.tile(PAPER, (COUNT, 1))
    draws[:, 7] += random.normal(0.0, 0.05, COUNT)
    found = bias_from_posterior(draws, (KAPPA, 0.0), (PHI, 0.2), random)
    inphase = np.rad2deg(0.05 * abs(np.cos(np.deg2rad(2.0 * PAPER[6]))) / (2.0 * KAPPA))
    leak = abs(found["quadrature_rate_dps"]) * np.deg2rad(0.2)
    # The error of a standard deviation is 1 / sqrt(2 n) of it, 0.5 %.
    assert found["inphase_bias_dps_sd"] == pytest.approx(inphase, rel=0.025)
    assert found["quadrature_bias_dps_sd"] == pytest.approx(leak, rel=0.025)
    assert found["rate_bias_dps_sd"] == pytest.approx(np.hypot(inphase, leak), rel=0.025)
    half = (found["rate_bias_dps_q95"] - found["rate_bias_dps_q05"]) / 2.0
    assert half == pytest.approx(1.645 * np.hypot(inphase, leak), rel=0.04)


def test_the_relative_uncertainty_of_the_bias_is_that_of_kappa():
    found = bias_from_posterior(np.tile(PAPER, (COUNT, 1)), (KAPPA, 0.014), (PHI, 0.0), np.random.default_rng(5))
    assert found["rate_bias_dps_sd"] / abs(found["rate_bias_dps"]) == pytest.approx(0.02, rel=0.03)


def test_drive_f1_and_f2_follow_the_device_formula_and_locked_lies_between_them():
    for drive in ("f1", "f2"):
        expected = rate_biases_dps(PAPER[None], KAPPA, PHI, drive)
        for name, value in bias_draws(PAPER[None], KAPPA, PHI, drive).items():
            np.testing.assert_allclose(value, expected[name], rtol=1e-12)
    rates = [abs(bias_draws(PAPER[None], KAPPA, PHI, one)["quadrature_rate_dps"][0]) for one in ("f2", "locked", "f1")]
    assert rates == sorted(rates)


def test_a_trim_removes_the_quadrature_and_keeps_the_in_phase_bias():
    random = np.random.default_rng(6)
    draws = np.tile(PAPER, (2000, 1))
    rate = RateSettings(KAPPA, PHI, "f1")
    found = trim(draws, standard_electrodes(gain_sd=0.02), Target(), random)
    after = intervals(quantities(found.after, rate))
    before = rate_biases_dps(PAPER, KAPPA, PHI, "f1")
    assert abs(after["quadrature_rate_dps"]) < 0.05 * abs(before["quadrature_rate_dps"])
    # Damping stays in the x, y frame whatever the stiffness axes do: C_xy is not tunable by springs.
    assert after["inphase_bias_dps"] == pytest.approx(before["inphase_bias_dps"], abs=1e-6)
    assert after["inphase_bias_dps_sd"] == pytest.approx(0.0, abs=1e-6)
    assert 0.0 < after["split_hz_q05"] < after["split_hz"] < after["split_hz_q95"] < 0.2
    unknown = intervals(quantities(found.after, RateSettings()))
    assert "rate_bias_dps" not in unknown
    assert unknown["split_hz"] == after["split_hz"]


def test_impossible_phases_and_gains_are_refused():
    draws, random = PAPER[None], np.random.default_rng(0)
    with pytest.raises(ConfigError, match="phase error"):
        bias_from_posterior(draws, (KAPPA, 0.0), (85.0, 1.0), random)
    with pytest.raises(ConfigError, match="angular gain"):
        bias_from_posterior(draws, (0.0, 0.0), (1.0, 0.0), random)
    with pytest.raises(ConfigError, match="phase error"):
        bias_draws(draws, KAPPA, np.array([95.0]))
