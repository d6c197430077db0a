"""Run rules: their rates against published ones, against simulation, and against the rate that is asked for."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom, norm

from reports.trend.rules import WESTERN_ELECTRIC, RunRule, alarm_probability, alarms, calibrated


def rate_of_simulation(rules: tuple[RunRule, ...], points: int, series: int, seed: int) -> tuple[float, float]:
    """Share of series of normal points that alarm at their last point, and its sd."""
    x = np.random.default_rng(seed).standard_normal((series, points))
    share = float(alarms(x, rules).any(axis=1).mean())
    return share, float(np.sqrt(share * (1.0 - share) / series))


def test_textbook_limits_have_the_published_average_run_length() -> None:
    """91.75 for rules 1 to 4 of Western Electric together (Champ and Woodall, Technometrics 29 (1987) 393, table 1)."""
    random, found = np.random.default_rng(5), []
    for _ in range(1500):
        x = random.standard_normal(1200)
        window = np.lib.stride_tricks.sliding_window_view(np.concatenate([np.full(7, np.nan), x]), 8)
        fired = alarms(window, WESTERN_ELECTRIC).any(axis=1)
        assert fired.any()
        found.append(int(np.argmax(fired)) + 1)
    sd = np.std(found) / np.sqrt(len(found))
    assert abs(np.mean(found) - 91.75) < 4.0 * sd


@pytest.mark.parametrize(
    "rules",
    [
        WESTERN_ELECTRIC,
        WESTERN_ELECTRIC[1:],
        (RunRule(8, 8, -0.4),),
        (RunRule(1, 1, 1.5), RunRule(2, 3, 1.0), RunRule(4, 5, 0.5), RunRule(8, 8, -0.2)),
    ],
    ids=["textbook", "without 1 of 1", "a limit below the centre", "narrow"],
)
def test_the_overlap_of_the_rules_is_counted_exactly(rules: tuple[RunRule, ...]) -> None:
    share, sd = rate_of_simulation(rules, 8, 400_000, 7)
    assert abs(alarm_probability(rules) - share) < 4.0 * sd


def test_single_rules_have_their_closed_forms() -> None:
    assert alarm_probability(WESTERN_ELECTRIC[:1]) == pytest.approx(2.0 * norm.sf(3.0), rel=1e-12)
    for rule in WESTERN_ELECTRIC[1:]:
        p = norm.sf(rule.limit)
        assert alarm_probability((rule,)) == pytest.approx(2.0 * p * binom.sf(rule.k - 2, rule.n - 1, p), rel=1e-12)


@pytest.mark.parametrize("points", [1, 2, 3, 4, 5, 7, 8, 30])
@pytest.mark.parametrize("rate", [0.0005, 0.01, 0.2])
def test_calibrated_rules_alarm_at_the_rate_that_is_asked_for(rate: float, points: int) -> None:
    rules = calibrated(rate, points)
    assert alarm_probability(rules) == pytest.approx(rate, rel=1e-6)
    assert all(rule.n <= points for rule in rules)
    share, sd = rate_of_simulation(rules, points, 200_000, points)
    assert abs(share - rate) < 4.5 * max(sd, np.sqrt(rate / 200_000))


def test_each_rule_has_the_same_share_and_is_wider_than_in_the_textbook_at_a_small_rate() -> None:
    rules = calibrated(0.001, 8)
    single = [alarm_probability((rule,)) for rule in rules]
    assert single == pytest.approx([single[0]] * 4, rel=1e-6)
    assert all(rule.limit > textbook.limit for rule, textbook in zip(rules, WESTERN_ELECTRIC, strict=True))


@pytest.mark.parametrize(
    ("points", "expected"),
    [
        ([0, 0, 0, 0, 0, 0, 0, 3.1], [True, False, False, False]),
        ([0, 0, 0, 0, 0, 2.1, 0, 2.1], [False, True, False, False]),
        ([0, 0, 0, 0, 0, 2.1, 0, -2.1], [False, False, False, False]),
        ([0, 0, 0, 0, 0, 2.1, 2.1, 0], [False, False, False, False]),
        ([0, 0, 0, -1.1, -1.1, 0, -1.1, -1.1], [False, False, True, False]),
        ([0.1] * 8, [False, False, False, True]),
        ([np.nan, *[0.1] * 7], [False, False, False, False]),
        ([3.1, 0, 0, 0, 0, 0, 0, 0], [False, False, False, False]),
    ],
)
def test_a_rule_alarms_where_the_last_point_completes_it(points: list[float], expected: list[bool]) -> None:
    assert alarms(np.array(points), WESTERN_ELECTRIC).tolist() == expected
