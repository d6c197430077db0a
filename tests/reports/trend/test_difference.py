"""Differences between two nights, against public formulas and by simulation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from pipeline.arrays import FloatArray
from reports.trend.charted import YIELD
from reports.trend.difference import Difference, compared, holm
from reports.trend.night import Grouping, Night, grouped_mean, share_interval
from reports.yields import clopper_pearson

NAME = "f1_hz"


def night(run: str, values: FloatArray, passed: FloatArray, groups: FloatArray | None = None) -> Night:
    n = len(values)
    by = Grouping("device", np.arange(n)) if groups is None else Grouping("lot", groups.astype(np.int64))
    return Night(run, "", tuple(f"D{k}" for k in range(n)), passed.astype(bool), {NAME: values}, by)


def drawn(
    random: np.random.Generator, run: str, lots: int = 5, each: int = 20, lot_sd: float = 1.0, shift: float = 0.0
) -> Night:
    groups = np.repeat(np.arange(lots), each)
    common = random.normal(0.0, lot_sd, lots)[groups]
    values = 535.0 + shift + common + random.normal(0.0, 1.0, groups.size)
    return night(run, values, values > 534.5, groups)


def row(name: str, comparison_rows: tuple[Difference, ...]) -> Difference:
    return next(one for one in comparison_rows if one.name == name)


def test_single_devices_are_compared_by_welch() -> None:
    random = np.random.default_rng(1)
    a, b = random.normal(5.0, 1.0, 30), random.normal(5.4, 2.0, 50)
    found = row(NAME, compared(night("a", a, a > 0), night("b", b, b > 0), (NAME,), False).differences)
    known = stats.ttest_ind(b, a, equal_var=False)
    # The variance of single devices as groups is the usual one.
    assert found.p == pytest.approx(known.pvalue, rel=1e-9)
    interval = known.confidence_interval(0.95)
    assert (found.low, found.high) == pytest.approx((interval.low, interval.high))


def test_the_same_devices_are_compared_one_by_one_in_any_order() -> None:
    random = np.random.default_rng(2)
    a = random.normal(5.0, 3.0, 40)
    b = a + random.normal(0.05, 0.1, 40)
    first, second = night("a", a, a > 5.0), night("b", b, b > 5.0)
    turned = replace(second, device_id=second.device_id[::-1], values={NAME: b[::-1]}, passed=second.passed[::-1])
    for later in (second, turned):
        comparison = compared(first, later, (NAME,), True)
        found = row(NAME, comparison.differences)
        assert comparison.paired
        assert found.p == pytest.approx(stats.ttest_rel(b, a).pvalue, rel=1e-9)
    assert found.high - found.low < 0.1, "the scatter of the devices is in the interval"


def test_identical_nights_differ_in_nothing() -> None:
    a = np.random.default_rng(3).normal(5.0, 1.0, 30)
    for paired in (True, False):
        for found in compared(night("a", a, a > 5.0), night("b", a, a > 5.0), (NAME,), paired).differences:
            assert (found.difference, found.p, found.differs) == (0.0, 1.0, False)


def test_equal_groups_give_the_standard_error_of_their_means() -> None:
    random = np.random.default_rng(4)
    values = random.normal(0.0, 1.0, (6, 15)) + random.normal(0.0, 2.0, (6, 1))
    found = grouped_mean(values.ravel(), Grouping("lot", np.repeat(np.arange(6), 15)))
    assert found.se == pytest.approx(values.mean(axis=1).std(ddof=1) / np.sqrt(6.0))
    assert (found.df, found.groups) == (5.0, 6)


def test_devices_that_were_not_identified_do_not_count_in_means() -> None:
    values = np.array([1.0, np.nan, 3.0, 5.0, np.nan, 7.0])
    found = grouped_mean(values, Grouping("lot", np.array([0, 0, 0, 1, 2, 1])))
    assert (found.value, found.groups) == (4.0, 2)
    none = grouped_mean(np.full(3, np.nan), Grouping("lot", np.arange(3)))
    assert np.isnan(none.value)
    one = grouped_mean(np.ones(3), Grouping("lot", np.zeros(3, dtype=np.int64)))
    assert one.interval() == (-np.inf, np.inf), "one lot says nothing about the scatter of lots"


def test_holm_raises_p_values_as_published() -> None:
    """Holm 1979; the values are those of R's p.adjust(c(0.01, 0.04, 0.03, 0.005), "holm")."""
    rows = [Difference(f"q{k}", 0.0, 0.0, 0.0, 0.0, 0.0, p) for k, p in enumerate((0.01, 0.04, 0.03, 0.005))]
    unknown = replace(rows[0], name="unknown", p=float("nan"))
    found = holm([*rows, unknown])
    assert [one.p_family for one in found[:4]] == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert np.isnan(found[4].p_family)
    assert not found[4].differs


def test_the_yield_interval_and_its_p_value_say_the_same() -> None:
    n = 100
    for passed in (50, 60, 64, 70, 90, 100):
        first = night("a", np.zeros(n), np.arange(n) < 50)
        second = night("b", np.zeros(n), np.arange(n) < passed)
        found = row(YIELD, compared(first, second, (), False).differences)
        assert found.low <= found.difference <= found.high
        assert (found.p < 0.05) == (found.low > 0.0)
    assert found.p < 1e-9
    back = row(YIELD, compared(second, first, (), False).differences)
    assert (back.low, back.high, back.p) == pytest.approx((-found.high, -found.low, found.p), rel=1e-6)


def test_all_and_none_passed_have_an_interval_of_some_width() -> None:
    n = 40
    both = [night(run, np.zeros(n), np.full(n, share)) for run, share in (("a", 1.0), ("b", 1.0), ("c", 0.0))]
    same = row(YIELD, compared(both[0], both[1], (), False).differences)
    assert (same.difference, same.p) == (0.0, 1.0)
    assert same.low == -same.high < -0.05
    assert row(YIELD, compared(both[0], both[2], (), False).differences).high < -0.8


def test_single_devices_have_the_binomial_interval() -> None:
    passed = np.arange(50) < 20
    found = share_interval(passed, Grouping("device", np.arange(50)))
    known = clopper_pearson(20, 50)
    assert (found.low, found.high) == (known.low, known.high)


def test_intervals_hold_and_false_differences_are_rare_where_lots_scatter() -> None:
    random, series = np.random.default_rng(5), 800
    covered, false, naive = {NAME: 0, YIELD: 0}, 0, 0
    for _ in range(series):
        first, second = drawn(random, "a"), drawn(random, "b")
        found = compared(first, second, (NAME,), False)
        assert (found.by, found.groups) == ("lot", (5, 5))
        for one in found.differences:
            covered[one.name] += one.low <= 0.0 <= one.high
        false += any(one.differs for one in found.differences)
        naive += stats.ttest_ind(second.values[NAME], first.values[NAME]).pvalue < 0.05
    for name, count in covered.items():
        assert clopper_pearson(count, series, level=0.999).high >= 0.95, name
    assert clopper_pearson(false, series, level=0.999).low <= 0.05
    assert naive > 0.3 * series, "lots as single devices would be as good, so the test shows nothing"


def test_a_shift_beyond_the_scatter_of_lots_is_found() -> None:
    random = np.random.default_rng(6)
    found = [compared(drawn(random, "a"), drawn(random, "b", shift=5.0), (NAME,), False).differences for _ in range(50)]
    assert sum(row(NAME, one).differs for one in found) >= 48


def test_nights_with_other_kinds_of_groups_are_compared_device_by_device_of_the_process() -> None:
    random = np.random.default_rng(7)
    known, unknown = drawn(random, "a"), night("b", random.normal(535.0, 1.0, 30), np.ones(30))
    found = compared(known, unknown, (NAME,), False)
    assert (found.by, found.groups) == ("device", (100, 30))


def test_one_lot_in_a_night_leaves_the_interval_unknown_not_wrong() -> None:
    random = np.random.default_rng(8)
    one = drawn(random, "a", lots=1, each=30)
    found = row(NAME, compared(one, drawn(random, "b"), (NAME,), False).differences)
    assert np.isnan(found.low)
    assert np.isnan(found.p)
    assert not found.differs
