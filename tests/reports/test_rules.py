"""Decision rules by name: verdicts against closed forms, and wrong tables."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from pipeline.errors import ConfigError, UsageError
from pipeline.inference.estimate import intervals
from reports.acceptance import by_estimates, probability_inside, zones
from reports.decision import decide
from reports.limits import Limit, load_limits
from reports.rules import Rule, rule_of
from reports.sequential import check_rule

TOLERANCE = Limit("split_hz", 1.0, 3.0)


def _limits(rule: Any) -> Any:
    return load_limits(
        {"rule": rule, "limits": {"split_hz": {"min": 1.0, "max": 3.0}, "theta_deg": {"min": 80, "max": 100}}}
    )


def test_each_rule_has_a_name_and_its_own_keys() -> None:
    assert rule_of("simple", "f") == Rule("simple")
    assert rule_of("probability", "f") == Rule()
    assert _limits({"kind": "guard_band", "k": 2}).rule == Rule("guard_band", k=2.0)
    assert _limits({"name": "guard_band", "consumer_risk": 0.025}).rule == Rule("guard_band", consumer_risk=0.025)
    assert _limits({"name": "probability", "pass_at": 0.9}).rule == Rule(pass_at=0.9)


@pytest.mark.parametrize(
    ("rule", "message"),
    [
        ("guard_band", "needs its width"),
        ({"kind": "guard_band", "k": 1, "consumer_risk": 0.1}, "needs its width"),
        ({"kind": "guard_band", "k": -1}, "rule.k is not valid"),
        ({"kind": "guard_band", "k": float("nan")}, "rule.k is not finite"),
        ({"kind": "guard_band", "consumer_risk": 0.5}, "rule.consumer_risk is not valid"),
        ({"kind": "simple", "k": 1}, "does not have these keys"),
        ({"k": 1}, "does not have these keys"),
        ({"name": "simple", "kind": "probability"}, "two names"),
        ("guard", "rule is not valid"),
        ({"pass_at": 0.1, "fail_at": 0.2}, "crossed"),
        ({"guard": 2}, "unknown key in rule"),
    ],
)
def test_wrong_rules_are_config_errors(rule: Any, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        _limits(rule)


def test_simple_acceptance_and_the_zones_of_a_guard_band() -> None:
    y, u = np.array([0.7, 0.9, 1.0, 1.1, 1.2, 2.0, 2.85, 3.0, 3.1, np.nan]), np.full(10, 0.1)
    simple = zones(Rule("simple"), TOLERANCE, y, u)
    np.testing.assert_array_equal(simple.conforms, [0, 0, 1, 1, 1, 1, 1, 1, 0, 0])
    np.testing.assert_array_equal(simple.violates, [1, 1, 0, 0, 0, 0, 0, 0, 1, 0])
    guarded = zones(Rule("guard_band", k=1.9), TOLERANCE, y, u)
    np.testing.assert_array_equal(guarded.conforms, [0, 0, 0, 0, 1, 1, 0, 0, 0, 0])
    np.testing.assert_array_equal(guarded.violates, [1, 0, 0, 0, 0, 0, 0, 0, 0, 0])


@given(
    st.floats(0.0, 4.0),
    st.floats(0.01, 2.0),
    st.floats(0.001, 0.49),
    st.sampled_from([(1.0, 3.0), (-np.inf, 3.0), (1.0, np.inf)]),
)
def test_a_consumers_risk_is_the_normal_probability_beyond_the_limits(
    y: float, u: float, risk: float, ends: Any
) -> None:
    limit = Limit("split_hz", *ends)
    inside = stats.norm.cdf(ends[1], y, u) - stats.norm.cdf(ends[0], y, u)
    found = zones(Rule("guard_band", consumer_risk=risk), limit, np.array([y]), np.array([u]))
    if abs(1.0 - inside - risk) > 1e-9 and abs(inside - risk) > 1e-9:
        assert bool(found.conforms[0]) == (1.0 - inside <= risk)
        assert bool(found.violates[0]) == (inside <= risk)


def test_the_probability_of_conformity_is_that_of_jcgm_106() -> None:
    """Specific risk 0.022750131948 of N(9.8, 0.1) within 9 .. 10: suncal, API manual 6 ("Specific Risk")."""
    p = probability_inside(np.array([[0.8], [0.2]]), np.array([0.1]))
    assert 1.0 - p[0] == pytest.approx(0.022750131948180274, abs=1e-12)
    # Breakdown voltage of a diode, y = -5.47 V, u = 0.05 V, limit -5.4 V: 92 % (JCGM 106:2012, 7.3, example).
    assert probability_inside(np.array([[0.07]]), np.array([0.05]))[0] == pytest.approx(0.92, abs=0.005)
    # An exact value conforms or does not.
    np.testing.assert_array_equal(probability_inside(np.array([[0.0, -1.0]]), np.zeros(2)), [1.0, 0.0])


def test_equivalent_probabilities_are_those_of_the_guard_band() -> None:
    assert Rule("simple").equivalent == (0.5, 0.5)
    assert Rule("guard_band", k=1.6448536).equivalent == pytest.approx((0.95, 0.05), abs=1e-6)
    assert Rule("guard_band", consumer_risk=0.025).guard_factor == pytest.approx(1.959964)


def test_a_device_is_judged_by_all_limits_and_named_by_the_worst() -> None:
    limits = _limits({"kind": "guard_band", "k": 2})
    estimates = {"split_hz": np.array([2.0, 3.1, 3.5, 2.0]), "theta_deg": np.array([90.0, 90.0, 101.0, np.nan])}
    u = {"split_hz": np.full(4, 0.1), "theta_deg": np.full(4, 0.1)}
    found = by_estimates(limits.rule, limits.limits, estimates, u)
    np.testing.assert_array_equal(found.passes, [True, False, False, False])
    np.testing.assert_array_equal(found.fails, [False, False, True, False])
    rng = np.random.default_rng(3)
    draws = {"split_hz": rng.normal(3.5, 0.1, (1, 400)), "theta_deg": rng.normal(101.0, 0.1, (1, 400))}
    decided = decide(limits, draws, ["ok"])
    assert decided.verdict == ("fail",)
    assert decided.failed_limits == ("theta_deg,split_hz",)


def test_the_estimate_of_a_decision_is_that_of_the_results_columns() -> None:
    """Simple acceptance at the median of the draws itself passes, and one ulp below it fails."""
    draws = {"split_hz": np.random.default_rng(1).normal(2.0, 0.3, (1, 768))}
    median = intervals({"split_hz": draws["split_hz"][0].copy()})["split_hz"]
    for end, verdict in ((median, "pass"), (np.nextafter(median, 0.0), "fail")):
        limits = load_limits({"rule": "simple", "limits": {"split_hz": {"max": float(end)}}})
        assert decide(limits, draws, ["ok"]).verdict == (verdict,)


def test_an_axis_across_90_deg_is_judged_as_an_arc() -> None:
    limits = _limits("simple")
    draws = {"theta_deg": np.random.default_rng(2).normal(0.0, 0.5, (2, 500)) + np.array([[89.9], [70.0]])}
    draws["theta_deg"] = 90.0 - np.mod(90.0 - draws["theta_deg"], 180.0)
    decided = decide(limits, {**draws, "split_hz": np.full((2, 1), 2.0)}, ["ok", "ok"])
    assert decided.verdict == ("pass", "fail")
    assert decided.failed_limits == ("", "theta_deg")


def test_a_growing_record_is_judged_by_probability_alone() -> None:
    check_rule(_limits("probability"))
    with pytest.raises(UsageError, match="grows"):
        check_rule(_limits("simple"))
