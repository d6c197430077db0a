"""The sequential rule: error of a fixed device over all analyses, in a model with known information."""

import numpy as np
import pytest
from scipy.special import ndtr

from reports.limits import Limits, load_limits
from reports.rules import Rule
from reports.sequential import boundary, checked, decide_at, ends, margin

LOOKS = 28
#: Shares of the final information at each analysis: even growth, doublings, and late jumps as a chirp shows them.
INFORMATION = {
    "even": np.linspace(0.1, 1.0, LOOKS),
    "doubling": 2.0 ** np.arange(1.0 - LOOKS, 1.0),
    "jumps": np.where(np.arange(LOOKS) < 14, 1e-6, np.where(np.arange(LOOKS) < 20, 0.1, 1.0))
    * np.linspace(0.5, 1.0, LOOKS),
}


def estimates(information: np.ndarray, runs: int, seed: int) -> np.ndarray:
    """(runs, looks) estimation errors in sd of each analysis: Brownian motion in information."""
    steps = np.diff(information, prepend=0.0)
    walk = np.cumsum(np.sqrt(steps) * np.random.default_rng(seed).standard_normal((runs, information.size)), axis=1)
    return walk / np.sqrt(information)


def verdicts(limits: Limits, z: np.ndarray, m: int = 1) -> list[str]:
    """The first verdict of each row of margins z (runs, looks); posteriors are normal."""
    assert ends(limits) == m
    out = []
    for row in z:
        found = "undecided"
        for k, one in enumerate(row, start=1):
            p = float(ndtr(one))
            alone = "pass" if p >= limits.rule.pass_at else "fail" if p <= limits.rule.fail_at else "undecided"
            found = checked(limits, alone, float(one), k, k == row.size)
            if found != "undecided":
                break
        out.append(found)
    return out


ONE = load_limits({"limits": {"split_hz": {"max": 3.0}}})


@pytest.mark.parametrize("growth", sorted(INFORMATION))
@pytest.mark.parametrize("distance", [2.0, 4.0, 16.0])
def test_a_device_beyond_two_final_sd_is_decided_wrongly_at_most_at_the_nominal_rate(growth, distance) -> None:
    runs, information = 1500, INFORMATION[growth]
    inside = verdicts(ONE, estimates(information, runs, 1) + distance * np.sqrt(information))
    outside = verdicts(ONE, estimates(information, runs, 2) - distance * np.sqrt(information))
    # Three sd of a share of 5 % of 1500 are 1.7 %.
    assert inside.count("fail") / runs <= 0.05 + 0.017
    assert outside.count("pass") / runs <= 0.05 + 0.017
    if distance >= 4.0:
        assert inside.count("undecided") / runs < 0.03


def test_the_rule_by_p_conform_alone_exceeds_the_nominal_rate_near_a_limit() -> None:
    z = estimates(INFORMATION["doubling"], 4000, 3) + 2.0 * np.sqrt(INFORMATION["doubling"])
    first = np.argmax(np.abs(z) >= 1.6449, axis=1)
    decided = z[np.arange(4000), first]
    assert np.mean(decided <= -1.6449) > 0.15


def test_a_device_at_a_corner_of_many_limits_is_not_failed_more_often_than_nominal() -> None:
    m, runs, information = 11, 1500, INFORMATION["jumps"]
    names = (
        "f1_hz",
        "f2_hz",
        "f3_hz",
        "zeta1",
        "zeta2",
        "zeta3",
        "quality1",
        "quality2",
        "quality3",
        "c12_per_s",
        "split_hz",
    )
    limits = load_limits({"limits": {name: {"max": 1.0} for name in names}})
    z = np.stack([estimates(information, runs, 10 + i) for i in range(m)]) + 2.0 * np.sqrt(information)
    failed = np.zeros(runs, dtype=bool)
    decided = np.zeros(runs, dtype=bool)
    for k in range(LOOKS):
        p, least = np.prod(ndtr(z[:, :, k]), axis=0), z[:, :, k].min(axis=0)
        for i in np.flatnonzero(~decided):
            alone = "pass" if p[i] >= 0.95 else "fail" if p[i] <= 0.05 else "undecided"
            found = checked(limits, alone, float(least[i]), k + 1, k == LOOKS - 1)
            decided[i], failed[i] = found != "undecided", found == "fail"
    assert failed.mean() <= 0.05 + 0.017
    assert (np.prod(ndtr(z[:, :, 0]), axis=0) <= 0.05).mean() > 0.5  # P(conform) alone would fail most at once


@pytest.mark.parametrize("last", [1, 2, 28])
def test_the_error_budget_is_spent_exactly(last: int) -> None:
    spent = sum(1.0 - ndtr(boundary(0.05, k)) for k in range(1, last))
    spent += 1.0 - ndtr(boundary(0.05, last, last=True) + 2.0)
    assert spent == pytest.approx(0.05, rel=1e-12)


def test_a_rule_without_error_never_decides_and_a_single_analysis_is_that_of_p_conform() -> None:
    strict = Limits(Rule(pass_at=1.0, fail_at=0.0), ONE.limits)
    assert checked(strict, "pass", 40.0, 1, True) == checked(strict, "fail", -40.0, 1, True) == "undecided"
    assert checked(ONE, "pass", 1.65, 1, True) == "pass"
    assert checked(ONE, "fail", -1.65, 1, True) == "fail"


def test_a_broad_posterior_about_a_narrow_tolerance_does_not_fail_a_device() -> None:
    limits = load_limits({"limits": {"rate_bias_dps": {"min": -20.0, "max": 20.0}}})
    draws = {"rate_bias_dps": np.random.default_rng(4).normal(30.0, 1000.0, 2000)}
    p, verdict = decide_at(limits, draws, "ok", 1)
    assert p < 0.05
    assert verdict == "undecided"


def test_margins_of_an_axis_hold_across_90_deg() -> None:
    limits = load_limits({"limits": {"theta_deg": {"min": 80.0, "max": 100.0}}})
    draws = np.random.default_rng(5).normal(88.0, 1.0, 4000)
    assert margin(limits, {"theta_deg": draws}) == pytest.approx(8.0, rel=0.05)
    across = np.where(draws + 4.0 > 90.0, draws + 4.0 - 180.0, draws + 4.0)
    assert margin(limits, {"theta_deg": across}) == pytest.approx(8.0, rel=0.05)
    assert margin(limits, {"theta_deg": draws - 88.0}) == pytest.approx(-80.0, rel=0.05)
    assert np.isnan(margin(limits, {"theta_deg": np.full(3, np.nan)}))
