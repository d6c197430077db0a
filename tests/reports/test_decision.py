"""The decision: posterior probability of conformity against the rule."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from pipeline.errors import UsageError
from reports.decision import conforms, conforms_each, decide
from reports.limits import load_limits

SPLIT = load_limits({"limits": {"split_hz": {"max": 3.0}}})
BOTH = load_limits({"limits": {"split_hz": {"max": 3.0}, "theta_deg": {"min": 80, "max": 100}}})


def _share(inside: int, n: int = 100) -> np.ndarray:
    """n splits of which ``inside`` conform."""
    return np.where(np.arange(n) < inside, 1.0, 5.0)


def test_a_probability_equal_to_a_threshold_is_decided() -> None:
    draws = {"split_hz": np.stack([_share(k) for k in (100, 95, 94, 6, 5, 0)])}
    decisions = decide(SPLIT, draws, ["ok"] * 6)
    assert decisions.verdict == ("pass", "pass", "undecided", "undecided", "fail", "fail")
    np.testing.assert_allclose(decisions.p_pass, [1.0, 0.95, 0.94, 0.06, 0.05, 0.0])
    assert decisions.failed_limits == ("", "", "", "split_hz", "split_hz", "split_hz")


def test_probability_is_that_of_all_limits_together_not_their_product() -> None:
    # The same half of the draws breaks both limits: 0.5 together, not 0.25.
    split = _share(50)
    theta = np.where(split < 3.0, -89.0, 0.0)
    decisions = decide(BOTH, {"split_hz": split[None], "theta_deg": theta[None]}, ["ok"])
    assert decisions.p_pass[0] == 0.5


def test_the_worst_limit_is_named_first() -> None:
    draws = {"split_hz": _share(40)[None], "theta_deg": np.where(np.arange(100) < 10, 90.0, 0.0)[None]}
    assert decide(BOTH, draws, ["ok"]).failed_limits == ("theta_deg,split_hz",)


@pytest.mark.parametrize("status", ["not_converged", "fit_failed", "misfit"])
def test_devices_whose_status_is_not_ok_are_undecided(status: str) -> None:
    decisions = decide(SPLIT, {"split_hz": _share(0)[None]}, [status])
    assert decisions.verdict == ("undecided",)
    assert decisions.failed_limits == ("",)
    assert np.isnan(decisions.p_pass[0])


def test_unknown_draws_leave_a_verdict_only_where_both_bounds_agree() -> None:
    unknown = np.full(100, np.nan)
    draws = {"split_hz": np.stack([_share(0), _share(100), unknown]), "theta_deg": np.stack([unknown] * 3)}
    decisions = decide(BOTH, draws, ["ok"] * 3)
    assert decisions.verdict == ("fail", "undecided", "undecided")
    assert decisions.p_pass[0] == 0.0
    assert np.isnan(decisions.p_pass[1:]).all()


def test_p_pass_is_the_normal_probability_within_its_sampling_error() -> None:
    rng = np.random.default_rng(5)
    mean, sd, n = np.linspace(2.7, 3.3, 7), 0.2, 20_000
    p = decide(SPLIT, {"split_hz": rng.normal(mean[:, None], sd, (7, n))}, ["ok"] * 7).p_pass
    expected = stats.norm.cdf((3.0 - mean) / sd)
    assert np.all(np.abs(p - expected) < 5 * np.sqrt(expected * (1 - expected) / n))


def test_conforms_keeps_the_shape_of_the_values_and_nan_does_not_conform() -> None:
    truth = {
        "split_hz": np.array([[1.0, 5.0], [3.0, np.nan]]),
        "theta_deg": np.array([[90.0, 90.0], [-79.0, 90.0]]),
    }
    np.testing.assert_array_equal(conforms(BOTH, truth), [[True, False], [False, False]])
    np.testing.assert_array_equal(conforms_each(BOTH, truth)["split_hz"], [[True, False], [True, False]])


def test_no_devices_are_accepted_and_missing_or_ragged_draws_are_refused() -> None:
    assert decide(SPLIT, {"split_hz": np.empty((0, 10))}, []).verdict == ()
    with pytest.raises(UsageError, match="no values of a limited quantity"):
        decide(BOTH, {"split_hz": np.ones((1, 10))}, ["ok"])
    with pytest.raises(UsageError, match="different shapes"):
        decide(SPLIT, {"split_hz": np.ones((2, 10))}, ["ok"])
    with pytest.raises(UsageError, match="different shapes"):
        decide(SPLIT, {"split_hz": np.ones((1, 0))}, ["ok"])
    with pytest.raises(UsageError, match="different shapes"):
        decide(BOTH, {"split_hz": np.ones((1, 10)), "theta_deg": np.ones((1, 9))}, ["ok"])


def test_a_single_value_stands_for_all_draws_of_a_known_or_unknown_quantity() -> None:
    split = np.stack([_share(100), _share(0)])
    known = decide(BOTH, {"split_hz": split, "theta_deg": np.full((2, 1), 90.0)}, ["ok"] * 2)
    assert known.verdict == ("pass", "fail")
    unknown = decide(BOTH, {"split_hz": split, "theta_deg": np.full((2, 1), np.nan)}, ["ok"] * 2)
    assert unknown.verdict == ("undecided", "fail")
