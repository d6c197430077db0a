"""Yields and risks: published values, limiting cases, and intervals for devices in groups."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from pipeline.errors import UsageError
from reports.clusters import clustering
from reports.yields import (
    by_group,
    clopper_pearson,
    measurement_uncertainty,
    poisson_binomial,
    wilson,
    yield_of,
    yield_of_verdicts,
)


def test_zero_of_1000_has_the_published_upper_limits() -> None:
    assert clopper_pearson(0, 1000).high == pytest.approx(0.00368, abs=5e-6)
    assert wilson(0, 1000).high == pytest.approx(0.00383, abs=5e-6)


@given(st.integers(0, 60), st.integers(0, 60), st.sampled_from([0.9, 0.95]))
def test_intervals_equal_those_of_scipy_and_swap_ends_with_the_counts(passed: int, failed: int, level: float) -> None:
    n = passed + failed
    if n:
        exact = stats.binomtest(passed, n).proportion_ci(level, "exact")
        score = stats.binomtest(passed, n).proportion_ci(level, "wilson")
        ours = (clopper_pearson(passed, n, level), wilson(passed, n, level))
        for theirs, mine in zip((exact, score), ours):
            assert (mine.low, mine.high) == pytest.approx((theirs.low, theirs.high), abs=1e-9)
    assert clopper_pearson(passed, n).low == pytest.approx(1.0 - clopper_pearson(failed, n).high, abs=1e-12)
    assert wilson(passed, n).low == pytest.approx(1.0 - wilson(failed, n).high, abs=1e-12)


@pytest.mark.parametrize(
    ("counts", "bounds", "envelope"),
    [
        ((0, 10, 0), (0.0, 0.0), (0.0, 0.30850)),
        ((10, 0, 0), (1.0, 1.0), (0.69150, 1.0)),
        ((0, 0, 10), (0.0, 1.0), (0.0, 1.0)),
        ((1, 0, 0), (1.0, 1.0), (0.025, 1.0)),
        ((0, 0, 0), (0.0, 1.0), (0.0, 1.0)),
        ((5, 3, 2), (0.5, 0.7), (0.18709, 0.93326)),
    ],
)
def test_undecided_devices_widen_bounds_and_envelope(
    counts: tuple[int, int, int], bounds: tuple[float, float], envelope: tuple[float, float]
) -> None:
    result = yield_of(*counts)
    assert result.bounds == bounds
    assert (result.envelope.low, result.envelope.high) == pytest.approx(envelope, abs=1e-5)
    assert math.isnan(result.value) == (sum(counts) == 0)


def test_negative_counts_are_refused() -> None:
    with pytest.raises(UsageError, match="negative"):
        yield_of(-1, 2)


def test_equal_probabilities_give_the_binomial() -> None:
    pmf = poisson_binomial(np.full(301, 0.3))
    np.testing.assert_allclose(pmf, stats.binom.pmf(np.arange(302), 301, 0.3), atol=1e-15)
    np.testing.assert_allclose(poisson_binomial(np.empty(0)), [1.0])


def test_certain_devices_carry_no_measurement_uncertainty() -> None:
    p = np.array([1.0] * 70 + [0.0] * 20 + [np.nan] * 10)
    certain = measurement_uncertainty(p)
    assert (certain.mean, certain.sd, certain.low, certain.high) == (70.0, 0.0, 70, 70)
    assert (certain.judged, certain.unknown) == (90, 10)
    doubtful = measurement_uncertainty(np.concatenate([p, np.full(100, 0.5)]))
    assert (doubtful.mean, doubtful.sd) == (120.0, 5.0)
    assert (doubtful.low, doubtful.high) == (
        70 + stats.binom.ppf(0.025, 100, 0.5),
        70 + stats.binom.ppf(0.975, 100, 0.5),
    )
    assert measurement_uncertainty(np.empty(0)).mean == 0.0


def _process(rng: np.random.Generator, wafers: int, dies: int, spread: float) -> tuple[list[str], list[str]]:
    """Verdicts and wafers where the yield of a wafer is Beta with mean 0.5 and sd ``spread`` (0: none)."""
    shape = 0.5 * (0.25 / spread**2 - 1.0) if spread else math.inf
    p = rng.beta(shape, shape, wafers) if spread else np.full(wafers, 0.5)
    passed = rng.random((wafers, dies)) < p[:, None]
    return ["pass" if one else "fail" for one in passed.ravel()], [
        f"W{w:02d}" for w in range(wafers) for _ in range(dies)
    ]


def test_the_clustered_interval_covers_the_process_where_wafers_differ() -> None:
    rng = np.random.default_rng(11)
    plain = clustered = 0
    runs = 300
    for _ in range(runs):
        verdicts, wafers = _process(rng, 8, 40, 0.15)
        inside = clustering(verdicts, wafers, "wafer").interval
        assert inside is not None
        clustered += inside.low <= 0.5 <= inside.high
        naive = yield_of_verdicts(verdicts).clopper_pearson
        plain += naive.low <= 0.5 <= naive.high
    # Binomial sd of a coverage of 0.95 over 300 runs is 1.3 %.
    assert clustered / runs > 0.95 - 4 * 0.0126
    assert plain / runs < 0.80


def test_between_wafer_sd_is_recovered_and_vanishes_for_equal_wafers() -> None:
    rng = np.random.default_rng(3)
    spread = clustering(*_process(rng, 400, 50, 0.15), "wafer")
    assert spread.between_sd == pytest.approx(0.15, abs=0.02)
    assert spread.design_effect == pytest.approx(1 + 49 * 0.09, rel=0.25)
    alike = clustering(*_process(rng, 400, 50, 0.0), "wafer")
    assert alike.design_effect == pytest.approx(1.0, abs=0.3)
    assert alike.between_sd is not None
    assert alike.between_sd < 0.03


def test_one_wafer_gives_no_process_interval_and_equal_verdicts_give_the_binomial_one() -> None:
    assert clustering(["pass", "fail"], ["W1", "W1"], "wafer").interval is None
    assert clustering([], [], "wafer").groups == 0
    equal = clustering(["pass"] * 10, ["W1"] * 5 + ["W2"] * 5, "wafer").interval
    assert equal is not None
    assert (equal.low, equal.high) == (clopper_pearson(10, 10).low, 1.0)
    # As many passed in each wafer: no scatter seen, yet never better than independent devices.
    balanced = clustering(["pass", "fail"] * 4, ["W1"] * 4 + ["W2"] * 4, "wafer")
    assert balanced.effective is not None
    assert balanced.effective <= 8


def test_groups_are_counted_by_wafer_and_by_lot() -> None:
    verdicts, lots, wafers = (
        ["pass", "fail", "undecided", "pass"],
        ["B", "A", "A", "A"],
        ["W1", "W1", "W1", "W2"],
    )
    assert [(g.lot, g.wafer, g.result.devices, g.result.passed) for g in by_group(verdicts, lots, wafers)] == [
        ("A", "W1", 2, 0),
        ("A", "W2", 1, 1),
        ("B", "W1", 1, 1),
    ]
    assert [(g.lot, g.result.devices) for g in by_group(verdicts, lots)] == [("A", 3), ("B", 1)]
    assert [g.lot for g in by_group(["pass"] * 4, ["L10", "L2", "", "7"])] == ["", "7", "L2", "L10"]
