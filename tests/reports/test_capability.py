"""Capability indices against closed forms, published figures and simulated lots."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from pipeline.store.schema import devices_table
from reports.capability import Index, _indices, capabilities
from reports.clustered import NestedSpread, nested_spread, variance_interval
from reports.devices import Devices
from reports.limits import Limit, Limits
from reports.rules import Rule

#: SAS/QC, data set Amps (example 5.3 of PROC CAPABILITY): amplification of 75 telephone amplifiers [dB].
AMPS = """
4.54 4.87 4.66 4.90 4.68 5.22 4.43 5.14 3.07 4.22 5.09 3.41 5.75 5.16 3.96 5.37 5.70 4.11 4.83 4.51 4.57 4.16 5.73 3.64 5.48 4.95
4.57 4.46 4.75 5.38 5.19 4.35 4.98 4.87 3.53 4.46 4.57 4.69 5.27 4.67 5.03 4.50 5.35 4.55 4.05 6.63 5.32 5.24 5.73 5.08 5.07 5.42
5.05 5.70 4.79 4.34 5.06 4.64 4.82 3.24 4.79 4.46 3.84 5.05 5.46 4.64 6.13 4.31 4.81 4.98 4.95 5.57 4.11 4.15 5.95
"""


def _devices(x: np.ndarray, u: float | np.ndarray = 0.0, quantity: str = "split_hz", **columns: Any) -> Devices:
    n = x.size
    table = {"device_id": [str(i) for i in range(n)], "status": ["ok"] * n, quantity: x}
    return Devices(devices_table({**table, f"{quantity}_sd": np.broadcast_to(np.asarray(u, float), n), **columns}))


def _one(devices: Devices, low: float, high: float, quantity: str = "split_hz", **more: Any) -> Any:
    return capabilities(devices, Limits(Rule(), (Limit(quantity, low, high),)), **more)[0]


def test_piston_rings_of_qcc() -> None:
    """R package qcc, vignette "A quick tour of qcc": 125 piston rings, limits 73.95 and 74.05, 95 % intervals."""
    s2 = 0.009785039**2
    interval = variance_interval(np.array([s2]), np.array([124]))
    spread = NestedSpread(125, 74.00118, s2 / 125, 124.0, s2, 124.0, interval, s2, 124.0, interval, ())
    cp, cpk = _indices(spread, s2, 124.0, interval, 0.0, 73.95, 74.05)
    assert cp is not None
    assert cpk is not None
    assert (cp.value, cp.low, cp.high) == pytest.approx((1.703, 1.491, 1.915), abs=5e-4)
    assert (cpk.value, cpk.low, cpk.high) == pytest.approx((1.663, 1.448, 1.878), abs=5e-4)


def test_amplifiers_of_sas() -> None:
    """SAS/QC 9.2 User's Guide, example 5.3: the 90 % interval of Cpk with limits 4 and 6 dB is 0.328 to 0.496."""
    found = _one(_devices(np.array([float(one) for one in AMPS.split()])), 4.0, 6.0)
    half = (found.cpk.high - found.cpk.value) * 1.6448536 / 1.9599640
    assert found.devices == 75
    assert (found.cpk.value - half, found.cpk.value + half) == pytest.approx((0.328, 0.496), abs=5e-4)
    assert found.cp == found.pp
    assert found.cpk == found.ppk


def test_nested_sums_of_squares_against_their_definition() -> None:
    rng = np.random.default_rng(1)
    lot, wafer = np.repeat(np.arange(3), 40), np.repeat(np.arange(12), 10)
    x = rng.normal(size=120) + 0.5 * lot + 0.2 * wafer
    found = nested_spread(x, [lot, wafer])
    # Equal groups: 10 devices a wafer, 40 a lot.
    lots = 40 * np.var([x[lot == one].mean() for one in range(3)], ddof=1)
    wafers = 10 * np.mean(
        [np.var([x[wafer == w].mean() for w in range(4 * one, 4 * one + 4)], ddof=1) for one in range(3)]
    )
    assert found.total == pytest.approx((lots - wafers) / 40 + (wafers - found.within) / 10 + found.within)
    assert found.within == pytest.approx(np.mean([np.var(x[wafer == w], ddof=1) for w in range(12)]))
    assert (found.within_df, found.mean_df, found.groups) == (108.0, 2.0, (3, 12))
    assert found.mean_variance == pytest.approx(np.var([x[lot == one].mean() for one in range(3)], ddof=1) / 3)
    assert found.total_df < 119.0
    plain = nested_spread(x, [np.zeros(120, dtype=int), np.arange(120)])
    assert (plain.groups, plain.total_df, plain.mean_variance) == ((), 119.0, pytest.approx(np.var(x, ddof=1) / 120))


def test_the_variance_of_the_measurement_is_removed() -> None:
    rng = np.random.default_rng(2)
    n, u = 40_000, 0.8
    found = _one(_devices(rng.normal(5.0, 1.0, n) + rng.normal(0.0, u, n), u), 2.0, 8.0)
    # Five sd of the sd of a normal sample of n, with the variance of the measurement added.
    assert found.sigma == pytest.approx(1.0, abs=5 * (1 + u**2) / math.sqrt(2 * n))
    assert found.uncertainty == pytest.approx(u)
    assert found.pp.low < 1.0 < found.pp.high


def test_a_spread_that_is_all_measurement_has_no_upper_end() -> None:
    x = np.random.default_rng(3).normal(5.0, 1.0, 50)
    found = _one(_devices(x, 2.0), 2.0, 8.0)
    assert found.sigma == 0.0
    assert (found.pp.value, found.pp.high) == (math.inf, math.inf)
    assert found.ppk == Index(math.inf, -math.inf, math.inf)


def test_an_error_that_all_devices_share_moves_the_mean_and_not_the_spread() -> None:
    x = np.random.default_rng(4).normal(5.0, 1.0, 400)
    alone = _one(_devices(x, 0.0), 2.0, 8.0)
    shared = _one(_devices(x, 0.6), 2.0, 8.0, common={"split_hz": np.full((1, 400), 0.6)})
    assert shared.sigma == pytest.approx(alone.sigma)
    assert shared.ppk.value == pytest.approx(alone.ppk.value)
    wide, narrow = (one.ppk.high - one.ppk.value for one in (shared, alone))
    expected = math.hypot(narrow / 1.959964, 0.6 / (3.0 * alone.sigma)) * 1.959964
    assert wide == pytest.approx(expected)
    # One that shifts devices unequally spreads them.
    unequal = _one(_devices(x, 0.6), 2.0, 8.0, common={"split_hz": 0.6 * np.where(np.arange(400) % 2, 1.0, -1.0)[None]})
    assert unequal.sigma == pytest.approx(math.sqrt(np.var(x, ddof=1) - 0.36))


def test_single_limits_and_few_devices() -> None:
    x = np.random.default_rng(5).normal(5.0, 1.0, 100)
    found = _one(_devices(x), -math.inf, 8.0)
    assert found.cp is None
    assert found.pp is None
    assert found.ppk.value == pytest.approx((8.0 - x.mean()) / (3.0 * x.std(ddof=1)))
    few = _one(_devices(x[:7]), 2.0, 8.0)
    assert (few.reason, few.ppk, few.devices) == ("few", None, 7)


def test_an_axis_is_measured_around_its_mean() -> None:
    """theta about 88 deg crosses 90: the same indices as the same spread about 0."""
    x = np.random.default_rng(6).normal(0.0, 3.0, 200)
    turned = 90.0 - np.mod(90.0 - (x + 88.0), 180.0)
    straight, across = (
        _one(_devices(theta, 0.1, "theta_deg"), low, high, "theta_deg")
        for theta, low, high in ((x, -10.0, 12.0), (turned, 78.0, 100.0))
    )
    for name in ("cp", "cpk", "pp", "ppk"):
        assert getattr(across, name).value == pytest.approx(getattr(straight, name).value)
    assert across.mean == pytest.approx(straight.mean + 88.0)
    everywhere = np.random.default_rng(7).uniform(-90.0, 90.0, 200)
    assert _one(_devices(everywhere, 0.1, "theta_deg"), -10.0, 12.0, "theta_deg").reason == "axis"


def _lots(rng: np.random.Generator, lots: int, wafers: int, dies: int) -> tuple[np.ndarray, list[str], list[str]]:
    lot = np.repeat(np.arange(lots), wafers * dies)
    wafer = np.repeat(np.arange(lots * wafers), dies)
    x = rng.normal(0.0, 0.8, lots)[lot] + rng.normal(0.0, 0.5, lots * wafers)[wafer] + rng.normal(0.0, 1.0, lot.size)
    return 5.0 + x, [f"L{i}" for i in lot], [f"W{i}" for i in wafer]


def test_intervals_of_clustered_lots_cover_the_process() -> None:
    """Cp, Pp and Ppk of 300 nights of 6 lots x 3 wafers x 12 dies: only intervals with groups cover the process."""
    rng = np.random.default_rng(8)
    true = 1.0 / math.sqrt(0.8**2 + 0.5**2 + 1.0)
    covered, plain = np.zeros(3), np.zeros(3)
    for _ in range(300):
        x, lots, wafers = _lots(rng, 6, 3, 12)
        for count, found in (
            (covered, _one(_devices(x, lot=lots, wafer=wafers), 2.0, 8.0)),
            (plain, _one(_devices(x), 2.0, 8.0)),
        ):
            count += [one.low <= at <= one.high for one, at in ((found.cp, 1.0), (found.pp, true), (found.ppk, true))]
    # 0.95 less four sd of a share of 300.
    assert np.all(covered / 300 >= 0.90)
    assert np.all(plain / 300 < 0.75)


def test_devices_that_are_not_ok_or_have_no_value_are_left_out() -> None:
    x = np.random.default_rng(9).normal(5.0, 1.0, 30)
    x[:5] = np.nan
    status = ["misfit"] * 10 + ["ok"] * 20
    found = _one(_devices(x, status=status), 2.0, 8.0)
    assert found.devices == 20
