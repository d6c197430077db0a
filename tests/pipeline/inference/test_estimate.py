"""From draws to quantities, intervals and status: one rule for every path."""

import math

import numpy as np
import pytest

from pipeline.device.gyro import PHYSICAL, to_cartesian, to_physical
from pipeline.inference.estimate import (
    RateSettings,
    cartesian_quantities,
    estimate_from,
    intervals,
    normal_intervals,
    quantities,
)
from pipeline.inference.gate import SURVIVING_SHARE, Gate, GoodnessOfFit, status_of
from pipeline.quantities import NAMES

GOOD = GoodnessOfFit(1.0, 1000.0, 1000)
RATE = RateSettings(0.7, 1.0, "f1")


def test_quantities_of_draws_are_all_result_quantities_in_their_shape(paper_device):
    found = quantities(np.tile(paper_device, (3, 2, 1)), RATE)
    assert set(found) == set(NAMES)
    assert {values.shape for values in found.values()} == {(3, 2)}
    assert found["quality1"][0, 0] == 0.5 / paper_device[3]


def test_the_split_of_cartesian_draws_has_no_cancellation(paper_device):
    x = to_cartesian(paper_device[None])[0]
    x[1:3] = 1e-10, 0.0
    exact = 1e-10 / (2.0 * np.pi)
    assert cartesian_quantities(x, RATE)["split_hz"] == pytest.approx(exact, rel=1e-9, abs=0.0)
    assert quantities(to_physical(x), RATE)["split_hz"] != pytest.approx(exact, rel=1e-6, abs=0.0)


def test_without_angular_gain_there_are_no_rate_biases_and_no_intervals_of_them(paper_device):
    found = quantities(np.tile(paper_device, (3, 1)), RateSettings())
    assert np.all(np.isnan(found["rate_bias_dps"]))
    assert not any("dps" in name for name in intervals(found))


def test_normal_intervals_are_those_of_normal_draws():
    draws = 5.0 + 2.0 * np.random.default_rng(1).standard_normal(200_000)
    found, expected = intervals({"f1_hz": draws}), normal_intervals({"f1_hz": (5.0, 2.0)})
    assert found == pytest.approx(expected, abs=0.03)


def test_the_bias_bound_is_zero_without_significant_excess():
    noise = 3.0 * math.sqrt(2.0 * 1000)
    assert GoodnessOfFit(1.0, 999.0 + noise, 1000).theta_bias_bound_deg(1.0) == 0.0
    bound = GoodnessOfFit(1.0, 1100.0 + noise, 1000).theta_bias_bound_deg(1e-3)
    assert bound == pytest.approx(1e-3 * math.sqrt(100.0 * (1.0 - SURVIVING_SHARE**2)) / SURVIVING_SHARE)


@pytest.mark.parametrize(
    ("goodness", "theta_sd_deg", "reasons", "status"),
    [
        (GOOD, 1e-3, {}, "ok"),
        (GOOD, 1e-3, {"not_converged": "R-hat"}, "not_converged"),
        (GoodnessOfFit(1.2, 1000.0, 1000), 1e-3, {"not_converged": "R-hat"}, "misfit"),
        (GoodnessOfFit(math.nan, 1000.0, 1000), 1e-3, {}, "misfit"),
        (GoodnessOfFit(1.0, 2000.0, 1000), 1e-1, {}, "misfit"),
        (GoodnessOfFit(1.0, 2000.0, 1000), None, {}, "ok"),
        (GoodnessOfFit(1.2, 1000.0, 1000), 1e-3, {"fit_failed": "singular"}, "fit_failed"),
        (None, 1e-3, {}, "ok"),
    ],
)
def test_the_status_is_the_worst_that_applies_and_gives_its_reason(goodness, theta_sd_deg, reasons, status):
    found, reason = status_of(goodness, theta_sd_deg, Gate(), **reasons)
    assert found == status
    assert (reason is None) == (status == "ok")


def test_an_estimate_keeps_its_draws_and_is_judged_by_the_sd_of_theta(paper_device):
    draws = np.tile(paper_device, (4000, 1))
    draws[:, PHYSICAL.index("theta_deg")] += np.random.default_rng(2).standard_normal(4000)
    found = quantities(draws, RATE)
    ok, misfit = (estimate_from(found, GoodnessOfFit(1.0, chi2, 1000), Gate()) for chi2 in (1000.0, 2000.0))
    assert (ok.status, misfit.status) == ("ok", "misfit")
    assert misfit.columns["theta_bias_bound_deg"] > 0.5
    assert "bias theta" in misfit.reason
    assert ok.draws["theta_deg"] is found["theta_deg"]
