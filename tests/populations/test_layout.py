"""Dies of a wafer, and the lot, wafer and die of each device number."""

from __future__ import annotations

from itertools import pairwise

import msgspec
import numpy as np
import pytest

from pipeline.errors import ConfigError
from populations.layout import die_centres, places, visiting_order
from populations.numbers import field_factor
from populations.spec import load_spec

WAFER = load_spec().wafer


def test_default_wafer_has_101_dies_inside_its_usable_disc() -> None:
    centres = die_centres(WAFER)
    assert len(centres) == 101
    assert np.hypot(*centres.T).max() <= 46.0
    np.testing.assert_allclose(centres.mean(axis=0), 0.0, atol=1e-12)


def test_every_die_of_every_wafer_is_used_once() -> None:
    placed = places(WAFER, np.arange(2 * 1010))
    assert len(set(zip(placed.wafer.tolist(), placed.die.tolist()))) == 2020
    assert set(placed.lot[:1010].tolist()) == set(range(5))
    assert set(placed.lot[1010:].tolist()) == set(range(5, 10))


def test_first_200_devices_sample_ten_wafers_evenly_and_their_whole_area() -> None:
    placed = places(WAFER, np.arange(200))
    assert np.unique(placed.wafer, return_counts=True)[1].tolist() == [20] * 10
    assert np.unique(placed.lot, return_counts=True)[1].tolist() == [40] * 5
    whole = (die_centres(WAFER) ** 2).sum(axis=1)
    for wafer in range(10):
        x, y = placed.x_mm[placed.wafer == wafer], placed.y_mm[placed.wafer == wafer]
        # A random choice of 20 of 101 dies would scatter by these standard errors; a well-spread one stays inside.
        error = np.sqrt((1.0 - 20 / 101) / 20)
        assert abs((x * x + y * y).mean() - whole.mean()) < error * whole.std()
        assert np.hypot(x.mean(), y.mean()) < error * np.sqrt(whole.mean() / 2.0)


def test_orders_are_permutations_with_distant_successive_dies() -> None:
    orders, centres = visiting_order(WAFER), die_centres(WAFER)
    assert len({tuple(order) for order in orders.tolist()}) == 8
    assert all(sorted(order) == list(range(101)) for order in orders.tolist())
    order = orders[0].tolist()
    jumps = [np.hypot(*(centres[a] - centres[b])) for a, b in pairwise(order[:30])]
    assert np.median(jumps) > 3 * WAFER.pitch_mm


def test_wafer_field_has_the_declared_correlation() -> None:
    factor, centres = field_factor(WAFER, 15.0), die_centres(WAFER)
    distance = np.linalg.norm(centres[:, None] - centres[None], axis=-1)
    np.testing.assert_allclose(factor @ factor.T, np.exp(-distance / 15.0), atol=1e-12)


def test_wafer_without_dies_is_a_config_error() -> None:
    with pytest.raises(ConfigError, match="edge_exclusion_mm"):
        die_centres(msgspec.structs.replace(WAFER, edge_exclusion_mm=60.0))
