"""Gauge R&R: the published example of AIAG, closed forms, coverage in balanced and unbalanced designs, axes, refusals."""

from __future__ import annotations

import numpy as np
import pytest

import reports.gauge as gauge
from pipeline.errors import UsageError
from reports.gauge import GaugeData, gauge_study, unwrapped
from reports.limits import Limit
from reports.words.gauge import categories, gauge_lines, verdict

# AIAG, Measurement Systems Analysis, 4th ed. (2010), ch. III B: 10 parts, appraisers A, B, C with three trials each.
AIAG = np.array(
    [
        [0.29, 0.41, 0.64, 0.08, 0.25, 0.07, 0.04, -0.11, -0.15],
        [-0.56, -0.68, -0.58, -0.47, -1.22, -0.68, -1.38, -1.13, -0.96],
        [1.34, 1.17, 1.27, 1.19, 0.94, 1.34, 0.88, 1.09, 0.67],
        [0.47, 0.50, 0.64, 0.01, 1.03, 0.20, 0.14, 0.20, 0.11],
        [-0.80, -0.92, -0.84, -0.56, -1.20, -1.28, -1.46, -1.07, -1.45],
        [0.02, -0.11, -0.21, -0.20, 0.22, 0.06, -0.29, -0.67, -0.49],
        [0.59, 0.75, 0.66, 0.47, 0.55, 0.83, 0.02, 0.01, 0.21],
        [-0.31, -0.20, -0.17, -0.63, 0.08, -0.34, -0.46, -0.56, -0.49],
        [2.26, 1.99, 2.01, 1.80, 2.12, 2.19, 1.77, 1.45, 1.87],
        [-1.36, -1.25, -1.31, -1.68, -1.62, -1.50, -1.49, -1.77, -2.16],
    ]
)


def aiag(values=AIAG):
    part, tester = np.repeat(np.arange(10), 9), np.tile(np.repeat(np.arange(3), 3), 10)
    return GaugeData(values.ravel(), part, tester, np.zeros(90, dtype=np.int64))


def test_the_example_of_aiag_has_its_published_results():
    # Variances, % study variation and categories as printed by Minitab for the same data (gageaiag), part x operator pooled.
    found = gauge_study("split_hz", aiag(), Limit("split_hz", -4.0, 4.0))
    published = {
        "repeatability": (0.03997, 18.42),
        "reproducibility": (0.05146, 20.90),
        "GRR": (0.09143, 27.86),
        "part": (1.08645, 96.04),
        "total variation": (1.17788, 100.00),
    }
    for name, (variance, study) in published.items():
        one = found.component(name)
        assert one.sd.value**2 == pytest.approx(variance, abs=6e-6)
        assert one.study.value == pytest.approx(study, abs=6e-3)
    assert found.pooled
    assert categories(found) == "4"
    # 6 sd of 8: 0.3024 * 6 / 8.
    assert found.component("GRR").tolerance.value == pytest.approx(22.68, abs=0.01)
    assert verdict(found).startswith("may be acceptable, but the interval also allows")
    # Two degrees of freedom of the appraisers: 97.5 % of chi2 is 7.38, 2.5 % is 0.0506.
    assert found.component("tester").df == 2
    assert found.component("tester").sd.high > 4.0 * found.component("tester").sd.value


def test_the_interval_of_repeatability_alone_is_that_of_chi_squared():
    random = np.random.default_rng(1)
    y = random.normal(size=(6, 1)) + 0.1 * random.normal(size=(6, 4))
    one = GaugeData(y.ravel(), np.repeat(np.arange(6), 4), np.zeros(24, int), np.zeros(24, int))
    found = gauge_study("split_hz", one)
    within = y.var(axis=1, ddof=1).mean()
    assert found.component("GRR").sd.value == pytest.approx(np.sqrt(within))
    # chi2 of 18 degrees of freedom: 8.231 and 31.526.
    assert found.component("GRR").sd.low == pytest.approx(np.sqrt(18 * within / 31.526), rel=0.02)
    assert found.component("GRR").sd.high == pytest.approx(np.sqrt(18 * within / 8.231), rel=0.02)
    between = y.mean(axis=1).var(ddof=1) - within / 4
    assert found.component("part").sd.value == pytest.approx(np.sqrt(between))
    assert found.unknown == ("tester", "session", "part x tester")


def simulated(random, sizes, spreads, kept=1.0):
    """Parts, testers, sessions, repeats; sds of part, tester, session, part x tester, repeatability; a share of the rows."""
    parts, testers, sessions, _ = sizes
    part, tester, session, _ = (a.ravel() for a in np.meshgrid(*map(np.arange, sizes), indexing="ij"))
    terms = ((part, parts), (tester, testers), (tester * sessions + session, testers * sessions))
    terms += ((part * testers + tester, parts * testers), (np.arange(part.size), part.size))
    y = sum(sd * random.normal(size=n)[codes] for sd, (codes, n) in zip(spreads, terms, strict=True))
    rows = random.random(part.size) < kept
    return GaugeData(y[rows], part[rows], tester[rows], session[rows])


@pytest.mark.parametrize(
    ("sizes", "spreads", "kept"),
    [
        ((10, 3, 1, 3), (1.0, 0.2, 0.0, 0.15, 0.2), 1.0),
        ((10, 3, 1, 3), (1.0, 0.2, 0.0, 0.1, 0.2), 0.7),
        ((8, 3, 3, 2), (1.0, 0.2, 0.1, 0.0, 0.1), 0.6),
    ],
    ids=["balanced", "unbalanced", "unbalanced sessions"],
)
def test_intervals_cover_in_balanced_and_unbalanced_designs(monkeypatch, sizes, spreads, kept):
    monkeypatch.setattr(gauge, "_DRAWS", 2000)
    random = np.random.default_rng(7)
    grr = np.sqrt(sum(sd**2 for sd in spreads[1:]))
    truth = {"repeatability": spreads[4], "tester": spreads[1], "GRR": grr, "part": spreads[0]}
    covered, bias = [], []
    for _ in range(120):
        found = gauge_study("split_hz", simulated(random, sizes, spreads, kept))
        each = [found.component(name).sd for name in truth]
        covered.append([sd.low <= value <= sd.high for sd, value in zip(each, truth.values(), strict=True)])
        share, true_share = found.component("GRR").study, 100 * grr / np.hypot(grr, spreads[0])
        covered[-1] += [
            share.low <= true_share <= share.high,
            found.categories.low <= 1.41 * spreads[0] / grr <= found.categories.high,
        ]
        bias.append([sd.value**2 - value**2 for sd, value in zip(each, truth.values(), strict=True)])
    # 95 % -+ 3.5 sd of 120.
    assert np.all(np.mean(covered, axis=0) > 0.88)
    z = np.mean(bias, axis=0) / (np.std(bias, axis=0) / np.sqrt(120))
    # Cutting negative variances at 0, and pooling, bias tester and repeatability by less than their own sd.
    assert np.all(np.abs(z) < 5.0)


def test_an_axis_has_no_jump_at_90_deg():
    random = np.random.default_rng(3)
    part = np.repeat(np.arange(5), 6)
    smooth = np.array([85.0, 88.0, 91.0, 94.0, 97.0])[part] + 0.5 * random.normal(size=30)
    wrapped = np.where(smooth > 90.0, smooth - 180.0, smooth)
    codes = (part, np.tile(np.repeat([0, 1], 3), 5), np.zeros(30, int))
    plain = gauge_study("theta_deg", GaugeData(smooth, *codes))
    axis = gauge_study("theta_deg", GaugeData(wrapped, *codes), axis=True)
    assert axis.component("GRR").sd.value == pytest.approx(plain.component("GRR").sd.value, rel=1e-9)
    assert axis.component("part").sd.value == pytest.approx(plain.component("part").sd.value, rel=1e-9)
    assert np.ptp(unwrapped(wrapped, part)) < 20.0


def test_a_large_mean_does_not_hide_small_differences():
    near = gauge_study("split_hz", aiag())
    far = gauge_study("f1_hz", aiag(1e6 + 1e-3 * AIAG))
    assert far.component("GRR").sd.value == pytest.approx(1e-3 * near.component("GRR").sd.value, rel=1e-5)


def test_one_limit_and_perfect_repeats():
    one_sided = gauge_study("split_hz", aiag(), Limit("split_hz", -np.inf, 4.0))
    grr = one_sided.component("GRR")
    assert grr.tolerance.value == pytest.approx(300.0 * grr.sd.value / (4.0 - AIAG.mean()))
    exact = gauge_study("split_hz", aiag(np.repeat(AIAG[:, :1], 9, axis=1)))
    assert exact.component("GRR").study.value == pytest.approx(0.0, abs=1e-5)
    assert "acceptable" in "\n".join(gauge_lines([exact]))


def test_no_repeats_but_several_testers_leave_the_interaction_in_the_repeatability():
    part, tester = np.repeat(np.arange(5), 3), np.tile(np.arange(3), 5)
    y = np.random.default_rng(4).normal(size=15)
    found = gauge_study("split_hz", GaugeData(y, part, tester, np.zeros(15, int)))
    assert found.pooled
    assert found.component("repeatability").df == 8


@pytest.mark.parametrize(
    ("values", "parts", "message"),
    [
        ([1.0, 2.0, 3.0], [0, 1, 2], "needs parts that are measured more than once"),
        ([1.0, 2.0], [0, 0], "needs parts that are measured more than once"),
        ([np.nan] * 4, [0, 0, 1, 1], "needs parts that are measured more than once"),
        ([1.0] * 3002, [0, 1] * 1501, "too many measurements"),
    ],
)
def test_designs_that_show_nothing_are_refused(values, parts, message):
    nothing = np.zeros(len(values), dtype=np.int64)
    with pytest.raises(UsageError, match=message):
        gauge_study("split_hz", GaugeData(np.array(values), np.array(parts), nothing, nothing))


def test_sessions_that_are_all_different_leave_no_repeatability():
    part = np.array([0, 0, 1, 1])
    with pytest.raises(UsageError, match="no measurement is repeated"):
        gauge_study("split_hz", GaugeData(np.arange(4.0), part, np.zeros(4, int), np.array([0, 1, 2, 3])))
