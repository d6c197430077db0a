"""Consumer's and producer's risk against closed forms, published figures and simulated devices."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import integrate, stats

from pipeline.store.schema import devices_table
from reports.acceptance import by_estimates, probability_inside
from reports.decision_risk import K_CURVE, bivariate_normal, decision_risks, normal_risks, risk_curve
from reports.devices import Devices
from reports.limits import Limit, Limits
from reports.rules import Rule


def _limit(low: float, high: float) -> Limit:
    return Limit("split_hz", low, high)


def test_the_resistors_of_jcgm_106() -> None:
    """Tolerance 1500 +- 0.2, process sd 0.12, measurement sd 0.04: 1.9 % and 3.7 % (JCGM 106:2012, 9.5, precision resistors)."""
    consumer, producer = normal_risks(1500.0, 0.12, 0.04, _limit(1499.8, 1500.2), 0.0)
    assert consumer == pytest.approx(0.0189422067, abs=1e-10)
    assert producer == pytest.approx(0.0372078002, abs=1e-10)


@pytest.mark.parametrize(
    ("in_tolerance", "percent"),
    [
        (0.6, 4.83860326),
        (0.7, 3.92234109),
        (0.8, 2.85583037),
        (0.9, 1.59995312),
        (0.95, 0.87100925),
        (0.99, 0.19991684),
    ],
)
def test_false_accepts_of_rp_19(in_tolerance: float, percent: float) -> None:
    """Draft of NCSLI RP-19, test uncertainty ratio 4, as quoted by suncal (test/test_risk.py, ``test_risk_values``)."""
    sd = 1.0 / stats.norm.ppf(0.5 * (1.0 + in_tolerance))
    # suncal integrates numerically, to 1e-6 of a percent.
    assert 100.0 * normal_risks(0.0, sd, sd / 4.0, _limit(-1.0, 1.0), 0.0)[0] == pytest.approx(percent, abs=2e-6)


def test_figures_of_deaver() -> None:
    """How to maintain your confidence (NCSL 1993), p. 7 and 10, as quoted by suncal (test/test_risk.py)."""
    plain = normal_risks(0.0, 1.0, 0.25, _limit(-2.0, 2.0), 0.0)
    assert plain == pytest.approx((0.008, 0.015), abs=5e-4)
    guarded = normal_risks(0.0, 1.0, 0.5, _limit(-2.0, 2.0), (2.0 - 2.0 * 0.91) / 0.5)
    assert guarded == pytest.approx((0.008, 0.066), abs=1e-3)


@given(
    st.floats(-3.0, 3.0), st.floats(0.05, 2.0), st.floats(0.01, 1.0), st.floats(0.0, 3.0),
    st.sampled_from([(-1.0, 1.0), (-math.inf, 1.0), (-1.0, math.inf)]),
)  # fmt: skip
def test_the_normal_risks_are_the_double_integrals(mean: float, sd: float, u: float, k: float, ends: Any) -> None:
    low, high = ends
    found = normal_risks(mean, sd, u, _limit(low, high), k)
    a, b = low + k * u, high - k * u

    def accepted(x: float) -> float:
        return float(stats.norm.cdf(b, x, u) - stats.norm.cdf(a, x, u)) if a < b else 0.0

    span = (max(low, mean - 12 * sd), min(high, mean + 12 * sd))
    points = [x for x in (low, high, a, b) if span[0] < x < span[1]]
    both = 0.0
    if span[0] < span[1]:
        both = integrate.quad(
            lambda x: accepted(x) * stats.norm.pdf(x, mean, sd), *span, points=points or None, limit=400
        )[0]
    whole = math.hypot(sd, u)
    all_accepted = stats.norm.cdf(b, mean, whole) - stats.norm.cdf(a, mean, whole) if a < b else 0.0
    conforming = stats.norm.cdf(high, mean, sd) - stats.norm.cdf(low, mean, sd)
    assert found == pytest.approx((all_accepted - both, conforming - both), abs=1e-6)


@given(st.floats(-4.0, 4.0), st.floats(-4.0, 4.0), st.floats(-0.999, 0.999))
def test_the_bivariate_normal_probability(h: float, k: float, correlation: float) -> None:
    expected = stats.multivariate_normal([0.0, 0.0], [[1.0, correlation], [correlation, 1.0]]).cdf([h, k])
    assert bivariate_normal(h, k, correlation) == pytest.approx(expected, abs=1e-8)


@pytest.mark.parametrize(
    ("h", "k"), [(math.inf, 0.3), (0.3, math.inf), (-math.inf, 1.0), (0.0, 0.0), (0.0, -1.0), (-0.0, 1.0)]
)
def test_the_bivariate_normal_probability_at_its_edges(h: float, k: float) -> None:
    for correlation in (-0.7, 0.0, 0.7):
        big = [min(max(one, -40.0), 40.0) for one in (h, k)]
        expected = stats.multivariate_normal([0.0, 0.0], [[1.0, correlation], [correlation, 1.0]]).cdf(big)
        assert bivariate_normal(h, k, correlation) == pytest.approx(expected, abs=1e-8)


def _devices(rule: Rule, limits: tuple[Limit, ...], n: int, seed: int, u: float = 0.5, bias: float = 0.0) -> Devices:
    """Devices of a normal process, with the posterior that the process as prior gives."""
    rng = np.random.default_rng(seed)
    wafer = np.arange(n) % 20
    columns: dict[str, Any] = {
        "device_id": [f"D{i}" for i in range(n)], "lot": ["L"] * n, "wafer": [f"W{w}" for w in wafer], "status": ["ok"] * n,
    }  # fmt: skip
    estimates, sds, inside = {}, {}, np.ones(n)
    for limit in limits:
        true = rng.normal(0.0, 1.0, n)
        measured = true + rng.normal(0.0, u, n)
        shrink = 1.0 / (1.0 + u**2)
        estimates[limit.quantity] = measured * shrink + bias
        sds[limit.quantity] = np.full(n, u * math.sqrt(shrink))
        inside *= probability_inside(-np.stack(limit.beyond(estimates[limit.quantity])), sds[limit.quantity])
        columns |= {f"true_{limit.quantity}": true, limit.quantity: estimates[limit.quantity]}
        columns |= {f"{limit.quantity}_sd": sds[limit.quantity]}
    if rule.by_estimate:
        found = by_estimates(rule, limits, estimates, sds)
        passes, fails = found.passes, found.fails
    else:
        passes, fails = inside >= rule.pass_at, inside <= rule.fail_at
    columns |= {"p_pass": inside, "verdict": list(np.where(passes, "pass", np.where(fails, "fail", "undecided")))}
    return Devices(devices_table(columns))


LIMITS = (_limit(-1.2, 1.5), Limit("f1_hz", -math.inf, 1.0))


@pytest.mark.parametrize(
    "rule", [Rule(), Rule("simple"), Rule("guard_band", k=1.0), Rule("guard_band", consumer_risk=0.1)]
)
def test_the_expected_number_of_wrong_decisions_agrees_with_the_truth(rule: Rule) -> None:
    """Calibrated posteriors: the count by the truth lies in the central 95 % in 19 of 20 cases; 60 cases a rule."""
    inside, cases = 0, 0
    for seed in range(10):
        for row in decision_risks(_devices(rule, LIMITS, 400, seed), Limits(rule, LIMITS)):
            for found in (row.consumer, row.producer):
                assert found.counted is not None
                assert found.value * row.judged == pytest.approx(found.expected, abs=1e-6)
                inside += found.expected_low <= found.counted <= found.expected_high
                cases += 1
    assert cases == 60
    # 0.05 of 60 and four sd.
    assert cases - inside <= 3 + 4 * math.sqrt(60 * 0.05 * 0.95)


def test_a_bias_of_the_estimates_shows_beside_the_truth() -> None:
    found = decision_risks(_devices(Rule("simple"), LIMITS, 2000, 1, bias=0.5), Limits(Rule("simple"), LIMITS))
    assert not all(
        one.expected_low <= (one.counted or 0) <= one.expected_high
        for row in found
        for one in (row.consumer, row.producer)
    )


def test_the_normal_process_agrees_with_the_devices_and_the_truth() -> None:
    """20,000 devices: posterior risks, closed form and count within five sd of a count."""
    rule = Rule("simple")
    limit = (_limit(-1.2, 1.5),)
    # The prior of JCGM 106 is that of the process; the measured value is what is compared.
    rng = np.random.default_rng(4)
    n, u = 20_000, 0.4
    true = rng.normal(0.0, 1.0, n)
    measured = true + rng.normal(0.0, u, n)
    p = probability_inside(-np.stack(limit[0].beyond(measured)), np.full(n, u))
    accepted = (measured >= -1.2) & (measured <= 1.5)
    devices = Devices(
        devices_table(
            {
                "device_id": [str(i) for i in range(n)], "status": ["ok"] * n, "split_hz": measured, "split_hz_sd": np.full(n, u),
                "true_split_hz": true, "p_pass": p, "verdict": list(np.where(accepted, "pass", "fail")),
            }
        )
    )  # fmt: skip
    row = decision_risks(devices, Limits(rule, limit))[1]
    for found in (row.consumer, row.producer):
        assert found.normal is not None
        assert found.counted is not None
        assert abs(found.counted / n - found.normal) < 5 * math.sqrt(found.normal / n)


def test_expected_and_counted_risks_agree_with_the_closed_form() -> None:
    """The posterior with the process as prior: N(r y, r u^2), r = s^2 / (s^2 + u^2); 200,000 devices."""
    rng = np.random.default_rng(8)
    n, sd, u, tolerance = 200_000, 0.12, 0.04, 0.2
    x = rng.normal(0.0, sd, n)
    y = x + rng.normal(0.0, u, n)
    shrink = sd**2 / (sd**2 + u**2)
    known = math.sqrt(shrink) * u
    p = stats.norm.cdf((tolerance - shrink * y) / known) - stats.norm.cdf((-tolerance - shrink * y) / known)
    columns: dict[str, Any] = {
        "device_id": np.arange(n).astype(str).tolist(), "status": ["ok"] * n, "p_pass": p, "true_split_hz": x,
        "verdict": np.where(np.abs(y) <= tolerance, "pass", "fail").tolist(),
    }  # fmt: skip
    limit = _limit(-tolerance, tolerance)
    row = decision_risks(Devices(devices_table(columns)), Limits(Rule("simple"), (limit,)))[0]
    for found, exact in zip((row.consumer, row.producer), normal_risks(0.0, sd, u, limit, 0.0), strict=True):
        assert found.counted is not None
        assert abs(found.counted / n - exact) < 4 * math.sqrt(exact / n)
        # Probabilities are averaged instead of zeros and ones counted, so they scatter less.
        assert found.value == pytest.approx(exact, abs=4 * math.sqrt(exact / n))
        assert found.expected_low <= found.counted <= found.expected_high


def test_the_curve_is_what_each_guard_band_gives() -> None:
    devices = _devices(Rule("simple"), LIMITS, 300, 2)
    curve = risk_curve(devices, Limits(Rule("simple"), LIMITS), K_CURVE)
    assert curve is not None
    for k in (0, 20, 47):
        rule = Rule("guard_band", k=float(K_CURVE[k]))
        row = decision_risks(_devices(rule, LIMITS, 300, 2), Limits(rule, LIMITS))[0]
        assert row.consumer.counted is not None
        assert row.producer.counted is not None
        assert curve.accepted[k] == pytest.approx(row.accepted / 300)
        assert curve.consumer[k] == pytest.approx(row.consumer.value)
        assert curve.producer[k] == pytest.approx(row.producer.value)
        assert curve.true_consumer[k] == pytest.approx(row.consumer.counted / 300)
        assert curve.true_producer[k] == pytest.approx(row.producer.counted / 300)


def test_without_judged_devices_there_is_no_risk() -> None:
    table = devices_table({"device_id": ["a"], "status": ["misfit"], "verdict": ["undecided"]})
    assert decision_risks(Devices(table), Limits(Rule(), LIMITS)) == ()
    assert risk_curve(Devices(table), Limits(Rule(), LIMITS), K_CURVE) is None
    empty: pa.Table = devices_table({"device_id": []})
    assert decision_risks(Devices(empty), Limits(Rule(), LIMITS)) == ()


def test_without_truth_nothing_is_counted() -> None:
    devices = _devices(Rule(), LIMITS, 50, 3)
    table = devices.table.select([name for name in devices.table.column_names if not name.startswith("true_")])
    found = decision_risks(Devices(table), Limits(Rule(), LIMITS))
    assert all(row.consumer.counted is None and row.producer.counted_interval is None for row in found)
