"""Quantiles from single order statistics are those of numpy, to the last bit."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from reports.order_statistics import median, quantiles

_VALUES = st.lists(st.floats(-1e9, 1e9) | st.sampled_from([0.0, 1.0, 0.1]), min_size=1, max_size=40)


@given(_VALUES, st.lists(st.floats(0.0, 1.0), min_size=1, max_size=4))
def test_quantiles_are_those_of_numpy(values: list[float], q: list[float]) -> None:
    x = np.array(values)
    np.testing.assert_array_equal(quantiles(x, q), np.quantile(x, q))
    np.testing.assert_array_equal(x, values)
    assert median(x) == np.median(x)


@pytest.mark.parametrize("n", [100_000, 100_001])
def test_quantiles_of_many_values_are_those_of_numpy(n: int) -> None:
    x = np.random.default_rng(3).normal(size=n)
    q = (0.01, 0.05, 0.5, 0.9, 0.95, 1.0)
    np.testing.assert_array_equal(quantiles(x, q), np.quantile(x, q))
    assert median(x) == np.median(x)


def test_no_values_have_no_quantiles() -> None:
    assert np.isnan(quantiles(np.empty(0), (0.5, 0.9))).all()
    assert np.isnan(median(np.empty(0)))
