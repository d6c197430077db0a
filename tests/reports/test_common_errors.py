"""Yield under errors that all devices share: limits of the mixture, and coverage of the yield of a process."""

import numpy as np
import pytest

from reports.clusters import clustering
from reports.common_errors import (
    GivenCommon,
    clustering_with_common,
    measurement_given_common,
    mixed_clopper_pearson,
    mixed_wilson,
    with_common,
)
from reports.rules import Rule
from reports.yields import clopper_pearson, measurement_uncertainty, wilson, yield_of_verdicts

RULE = Rule()


def _verdicts(p: np.ndarray) -> list[str]:
    return ["pass" if one >= RULE.pass_at else "fail" if one <= RULE.fail_at else "undecided" for one in p]


@pytest.mark.parametrize(("count", "n"), [(0, 20), (20, 20), (7, 20), (480, 1000)])
def test_equal_counts_give_the_plain_intervals(count: int, n: int) -> None:
    counts = np.full(9, float(count))
    for mixed, plain in (
        (mixed_clopper_pearson(counts, np.full(9, float(n)), ""), clopper_pearson(count, n)),
        (mixed_wilson(counts, n), wilson(count, n)),
    ):
        assert (mixed.low, mixed.high) == pytest.approx((plain.low, plain.high), abs=2e-9)


def test_without_declared_errors_nothing_changes() -> None:
    found = yield_of_verdicts(["pass"] * 40 + ["fail"] * 60)
    assert with_common(found, None) is found


def test_a_large_common_error_keeps_the_interval_wide_however_many_devices_there_are() -> None:
    # One half of the possible errors lets all devices pass, the other none.
    for n in (100, 20_000):
        p = np.repeat(np.array([[0.0], [1.0]] * 50), n, axis=1)
        found = with_common(yield_of_verdicts(_verdicts(p.mean(axis=0))), GivenCommon(p, RULE))
        assert found.clopper_pearson.low < 0.05
        assert found.clopper_pearson.high > 0.95
        count = measurement_given_common(GivenCommon(p, RULE))
        assert (count.mean, count.sd) == pytest.approx((n / 2.0, n / 2.0))
        assert (count.low, count.high) == (0, n)


def test_independent_devices_keep_their_poisson_binomial_number() -> None:
    p = np.random.default_rng(2).uniform(size=60)
    mixed, plain = measurement_given_common(GivenCommon(np.tile(p, (7, 1)), RULE)), measurement_uncertainty(p)
    assert (mixed.mean, mixed.sd) == pytest.approx((plain.mean, plain.sd))
    assert (mixed.low, mixed.high, mixed.judged) == (plain.low, plain.high, plain.judged)


def test_the_interval_covers_the_yield_of_the_process_where_the_plain_one_does_not() -> None:
    """Margins N(0, 1) against a limit at 0.5, measured by testers with errors N(0, 0.2): the yield is Phi(0.5)."""
    rng, sessions, n, sd = np.random.default_rng(5), 300, 400, 0.2
    nodes = sd * rng.permutation(_normal_nodes(100))
    truth, covered, plain, clustered = 0.6914624612740131, 0, 0, 0
    wafers = [f"W{i % 20}" for i in range(n)]
    for _ in range(sessions):
        measured = rng.standard_normal(n) + sd * rng.standard_normal()
        p = (measured - nodes[:, None] < 0.5).astype(np.float64)
        verdicts, given = _verdicts(p.mean(axis=0)), GivenCommon(p, RULE)
        before = yield_of_verdicts(verdicts)
        after = with_common(before, given)
        covered += after.clopper_pearson.low <= truth <= after.clopper_pearson.high
        plain += before.clopper_pearson.low <= truth <= before.clopper_pearson.high
        group = clustering_with_common(clustering(verdicts, wafers, "wafer"), wafers, given).interval
        assert group is not None
        clustered += group.low <= truth <= group.high
    # Three sd of a binomial share of 0.95 in 300 sessions are 0.038; Clopper-Pearson and the hull are conservative.
    assert covered / sessions > 0.95 - 0.038
    assert clustered / sessions > 0.95 - 0.038
    assert plain / sessions < 0.5


def _normal_nodes(count: int) -> np.ndarray:
    from scipy.special import ndtri

    return np.asarray(ndtri((np.arange(count) + 0.5) / count))
