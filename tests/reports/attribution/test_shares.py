"""Shares against closed forms: an additive function of normals, its exceedance of a limit, and a product."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import ndtr

from pipeline.errors import UsageError
from reports.attribution.given_data import LEAST_LOTS, given_data_shares
from reports.attribution.shapley import shapley_shares
from reports.attribution.verdicts import explained_verdicts

SIZES = np.array([0.5, 0.3, 0.7, 0.4])
EACH = np.arange(4)
LIMIT = 1.0


def outputs(z):
    total = z @ SIZES
    return np.stack([total, (total > LIMIT).astype(float), 0.5 * z[:, 2] + z[:, 2] * z[:, 3]], axis=1)


def lots_of(random, lots, wafers=2, dies=20):
    """Lot of each device, and a number of the lot, of the wafer, and two of the die."""
    n = lots * wafers * dies
    lot, wafer = np.arange(n) // (wafers * dies), np.arange(n) // dies
    levels = (random.standard_normal(lots)[lot], random.standard_normal(lots * wafers)[wafer])
    return lot, np.stack([*levels, *random.standard_normal((2, n))], axis=1)


def shapley_of_two_groups(a, b):
    """Shapley share of the first of two normals with sds a, b in 1[sum > limit]: V1 + V12 / 2, by quadrature."""
    p = ndtr(-LIMIT / np.hypot(a, b))

    def explained(own, other):
        square, _ = quad(
            lambda x: ndtr((own * x - LIMIT) / other) ** 2 * np.exp(-x * x / 2) / np.sqrt(2 * np.pi), -9, 9
        )
        return square - p * p

    whole, first, second = p * (1 - p), explained(a, b), explained(b, a)
    return (first + (whole - first - second) / 2) / whole


def test_shares_of_an_additive_population_are_those_of_its_variances():
    found = shapley_shares(outputs, EACH, 20_000, 1)
    additive, product = SIZES**2 / np.sum(SIZES**2), np.array([0.0, 0.0, 0.6, 0.4])
    for k, truth in ((0, additive), (2, product)):
        assert np.all(np.abs(found.value[:, k] - truth) < 3.0 * np.maximum(found.sd[:, k], 1e-12))
    np.testing.assert_allclose(found.value.sum(axis=0), 1.0, atol=1e-12)
    np.testing.assert_allclose(
        found.variance, outputs(np.random.default_rng(0).normal(size=(10**6, 4))).var(0), rtol=0.03
    )


def test_the_share_of_a_group_in_a_loss_is_that_of_the_closed_form():
    # Numbers 0 and 2 are one group, 1 and 3 the other: each sum is one normal, so that the loss has two inputs.
    group, a, b = np.array([0, 1, 0, 1]), np.hypot(0.5, 0.7), np.hypot(0.3, 0.4)
    found = shapley_shares(lambda z: outputs(z)[:, 1:2], group, 40_000, 2)
    assert found.value[0, 0] == pytest.approx(shapley_of_two_groups(a, b), abs=3.0 * found.sd[0, 0])
    assert found.sd[0, 0] < 0.01


def test_intervals_hold_over_seeds():
    truth = SIZES**2 / np.sum(SIZES**2)
    held = [
        (found.low[:, 0] <= truth) & (truth <= found.high[:, 0])
        for found in (shapley_shares(lambda z: outputs(z)[:, :1], EACH, 400, seed) for seed in range(150))
    ]
    # 600 intervals, in groups of four that are correlated: 95 % +- 4 sd of 150 draws.
    assert 0.88 <= np.mean(held) <= 0.99


def test_stored_devices_give_the_shares_of_nested_levels():
    truth = np.array([SIZES**2 / np.sum(SIZES**2), [0.0, 0.0, 0.6, 0.4]])
    random = np.random.default_rng(3)
    values, held = [], []
    for _ in range(60):
        lot, z = lots_of(random, 60)
        found = given_data_shares(z, EACH, lot, outputs(z)[:, [0, 2]])
        values.append(found.value[:4].T)
        held.append((truth >= found.low[:4].T) & (truth <= found.high[:4].T))
    scatter = np.std(values, axis=0, ddof=1)
    assert np.all(np.abs(np.mean(values, axis=0) - truth) < 3.5 * scatter / np.sqrt(60))
    assert 0.85 <= np.mean(held) <= 0.99
    np.testing.assert_allclose(found.value.sum(axis=0), 1.0, atol=1e-12)


def test_a_number_of_the_lot_that_does_nothing_has_no_share():
    # Estimators for independent rows give it one: rbd_fast 0.08 with forty lots (tests/measure/attribution_peers.py).
    random = np.random.default_rng(4)
    found = []
    for _ in range(60):
        lot, z = lots_of(random, 30)
        idle = random.standard_normal(30)[lot]
        found.append(given_data_shares(np.column_stack([z, idle]), np.arange(5), lot, outputs(z)[:, :1]).value[4, 0])
    assert abs(np.mean(found)) < 3.5 * np.std(found, ddof=1) / np.sqrt(60)


def test_noise_is_the_rest_of_stored_devices():
    random = np.random.default_rng(5)
    lot, z = lots_of(random, 200)
    noisy = z @ SIZES + np.sqrt(np.sum(SIZES**2)) * random.standard_normal(len(z))
    found = given_data_shares(z, EACH, lot, noisy[:, None])
    assert found.value[4, 0] == pytest.approx(0.5, abs=3.0 * found.sd[4, 0])


def test_few_lots_are_refused_and_a_constant_has_no_shares():
    lot, z = lots_of(np.random.default_rng(6), LEAST_LOTS - 1)
    with pytest.raises(UsageError, match="too few lots"):
        given_data_shares(z, EACH, lot, z[:, :1])
    lot, z = lots_of(np.random.default_rng(6), LEAST_LOTS)
    assert np.all(np.isnan(given_data_shares(z, EACH, lot, np.ones((len(z), 1))).value))
    assert np.all(np.isnan(shapley_shares(lambda z: np.ones((len(z), 1)), EACH, 100, 0).value))


def test_verdicts_that_differ_at_random_lower_their_explained_share():
    # v = t with probability 1 - e, else the opposite: r = (1 - 2 e) sd(t) / sd(v).
    random, e, p = np.random.default_rng(7), 0.1, 0.3
    lot = np.arange(40_000) // 100
    lost = random.random(lot.size) < p
    flipped = random.random(lot.size) < e
    found = explained_verdicts(lost, lost ^ flipped, lot)
    q = p * (1 - e) + (1 - p) * e
    truth = (1 - 2 * e) ** 2 * p * (1 - p) / (q * (1 - q))
    assert found is not None
    assert found.low < truth < found.high
    assert found.value == pytest.approx(truth, abs=3.5 * found.sd)
    exact = explained_verdicts(lost, lost, lot)
    assert exact is not None
    assert (exact.value, exact.high) == (1.0, 1.0)
    assert 0.99 < exact.low < 1.0
    assert explained_verdicts(np.zeros(40, bool), np.ones(40, bool), np.arange(40)) is None
