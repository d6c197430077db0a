"""Control charts of few nights: exact statistics, limits, and the rate of false alarms over simulated series."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from reports.trend.chart import BEFORE, anscombe, judged, prediction, q_statistics, share_at, share_of
from reports.trend.rules import alarms, calibrated
from reports.yields import clopper_pearson


def test_q_is_the_normal_score_of_the_t_test_of_a_night_against_those_before_it() -> None:
    x = np.random.default_rng(1).normal(530.0, 2.0, 9)
    q = q_statistics(x)
    assert np.isnan(q[:BEFORE]).all()
    for i in range(BEFORE, x.size):
        before = x[:i]
        t = (x[i] - before.mean()) / (before.std(ddof=1) * np.sqrt(1.0 + 1.0 / i))
        assert q[i] == pytest.approx(stats.norm.ppf(stats.t.cdf(t, i - 1)), abs=1e-8)


def test_q_statistics_are_independent_and_normal_whatever_mean_and_spread() -> None:
    x = np.random.default_rng(2).normal(1e6, 1e-2, (20_000, 12))
    q = q_statistics(x)[:, BEFORE:]
    assert stats.kstest(q[:, 0], "norm").pvalue > 1e-3
    assert stats.kstest(q[:, -1], "norm").pvalue > 1e-3
    correlation = np.corrcoef(q.T) - np.eye(q.shape[1])
    assert np.abs(correlation).max() < 4.5 / np.sqrt(len(q))


@pytest.mark.parametrize("nights", [3, 6, 21])
@pytest.mark.parametrize("rate", [0.01, 0.05])
def test_false_alarms_over_1000_series_of_ten_charts_are_at_the_nominal_rate(nights: int, rate: float) -> None:
    charts, series = 10, 1000
    x = np.random.default_rng(nights).normal(5.0, 3.0, (series, charts, nights))
    q = q_statistics(x)[..., BEFORE:]
    raised = int(alarms(q, calibrated(share_of(rate, charts), nights - BEFORE)).any(axis=(1, 2)).sum())
    found = clopper_pearson(raised, series, level=0.9999)
    assert found.low <= rate <= found.high
    # The normal limits of a chart with known mean and sd would alarm far more often with few nights.
    mean, sd = x[..., :-1].mean(axis=-1), x[..., :-1].std(axis=-1, ddof=1)
    z = stats.norm.isf(0.5 * share_of(rate, charts))
    naive = int((np.abs(x[..., -1] - mean) > z * sd).any(axis=1).sum())
    if nights <= 6:
        assert clopper_pearson(naive, series, level=0.9999).low > rate


def test_limits_are_those_of_a_prediction_interval() -> None:
    x = np.array([4.1, 3.9, 4.4, 4.0, 4.2])
    low, high = prediction(x, np.full(5, 1.959963984540054))
    before = x[:4]
    half = stats.t.ppf(0.975, 3) * before.std(ddof=1) * np.sqrt(1.25)
    assert (low[4], high[4]) == pytest.approx((before.mean() - half, before.mean() + half))
    assert np.isnan(low[:BEFORE]).all()


@settings(max_examples=40)
@given(st.integers(0, 10_000), st.integers(4, 15), st.sampled_from([0.01, 0.2]))
def test_a_night_breaks_the_first_rule_where_it_is_outside_its_limits(seed: int, nights: int, rate: float) -> None:
    x = np.random.default_rng(seed).normal(100.0, 1.0, nights)
    x[-1] += 4.0
    found = judged(x, rate)
    outside = (x < found.low) | (x > found.high)
    assert found.broken[:, 0].tolist() == outside.tolist()
    again = judged(3.0 - 2.0 * x, rate)
    assert again.broken.tolist() == found.broken.tolist(), "the verdict depends on scale and sign"


def test_nights_without_spread_alarm_at_any_other_value_and_only_then() -> None:
    same = judged(np.full(8, 0.5), 0.01)
    assert not same.broken.any()
    assert same.q[BEFORE:].tolist() == [0.0] * 6
    other = judged(np.array([0.5] * 7 + [0.4]), 0.01)
    assert other.broken[-1, 0]
    assert other.q[-1] == -np.inf


@pytest.mark.parametrize("nights", [1, 2])
def test_too_few_nights_are_not_judged(nights: int) -> None:
    found = judged(np.arange(float(nights)), 0.01)
    assert found.rules == ()
    assert not found.broken.any()
    assert np.isnan(found.q).all()


def test_a_shift_of_many_sd_is_found_and_a_lasting_small_one_by_the_run_rules() -> None:
    random = np.random.default_rng(4)
    x = random.normal(0.0, 1.0, (60, 31))
    x[:, -1] += 10.0
    large = [judged(row, 0.01).broken[-1] for row in x]
    assert np.mean([row[0] for row in large]) > 0.95
    x = random.normal(0.0, 1.0, (60, 30))
    x[:, -8:] += 1.5
    lasting = [judged(row, 0.01).broken[-8:] for row in x]
    point = np.mean([row[:, 0].any() for row in lasting])
    assert np.mean([row.any() for row in lasting]) > point + 0.05


def test_yields_that_scatter_by_chance_alone_alarm_at_most_at_the_stated_rate() -> None:
    devices, nights, series = 100, 12, 3000
    for share in (0.5, 0.97):
        count = np.random.default_rng(6).binomial(devices, share, (series, nights)).astype(float)
        angle, least = anscombe(count, np.full((series, nights), float(devices)))
        q = q_statistics(angle, least)[:, BEFORE:]
        raised = int(alarms(q, calibrated(0.02, nights - BEFORE)).any(axis=1).sum())
        assert clopper_pearson(raised, series, level=0.9999).low <= 0.02


def test_the_angle_of_a_yield_has_its_binomial_sd_and_goes_back() -> None:
    count = np.random.default_rng(8).binomial(200, 0.4, 100_000).astype(float)
    angle, sd = anscombe(count, np.full(count.size, 200.0))
    assert angle.std() == pytest.approx(sd[0], rel=0.02)
    assert share_at(angle).mean() == pytest.approx(0.4, abs=2e-3)
    assert share_at(np.array([-0.2, 2.0, np.nan])).tolist()[:2] == [0.0, 1.0]


def test_the_charts_together_have_the_rate_of_the_family() -> None:
    for charts in (1, 7, 40):
        assert 1.0 - (1.0 - share_of(0.01, charts)) ** charts == pytest.approx(0.01, rel=1e-9)
