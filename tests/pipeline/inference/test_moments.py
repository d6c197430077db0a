"""Moments of lines against numpy, and cosines and sines of axes against those of the library."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.axial import double_angle
from pipeline.inference.estimate import intervals
from pipeline.inference.moments import moments


@pytest.mark.parametrize("shape", [(5, 1), (3, 4, 7), (2, 3072)])
def test_moments_are_those_of_numpy(shape):
    lines = 1e3 + np.random.default_rng(1).normal(size=shape)
    mean, variance = moments(lines)
    np.testing.assert_allclose(mean, lines.mean(axis=-1), rtol=1e-14)
    np.testing.assert_allclose(variance, lines.var(axis=-1), rtol=1e-9, atol=1e-20)
    lines[0] = np.nan
    mean, variance = moments(lines)
    assert np.isnan(mean[0]).all()
    assert np.isfinite(mean[1:]).all()
    assert np.isfinite(variance[1:]).all()


def test_cosine_and_sine_of_the_double_angle():
    axes = np.concatenate([np.linspace(-90.0, 90.0, 1001), [45.0, -45.0, 89.9999999, 1e-9]])
    cos, sin = double_angle(axes)
    np.testing.assert_allclose(cos, np.cos(np.deg2rad(2.0 * axes)), atol=5e-16)
    np.testing.assert_allclose(sin, np.sin(np.deg2rad(2.0 * axes)), atol=5e-16)


@pytest.mark.parametrize("centre", [-89.9999, 0.0, 30.0, 90.0])
@pytest.mark.parametrize("spread", [1e-3, 5.0, 25.0])
def test_interval_of_an_axis_does_not_depend_on_where_its_first_draw_is(centre, spread):
    away = np.random.default_rng(2).normal(scale=spread, size=4001)
    away = np.clip(away, -80.0, 80.0)
    theta = 90.0 - np.mod(90.0 - (centre + away), 180.0)
    found = [intervals({"theta_deg": np.roll(theta, k)}) for k in (0, 1, 77)]
    for one in found:
        assert one["theta_deg_sd"] == pytest.approx(away.std(), rel=0.02)
        for name, value in one.items():
            assert value == pytest.approx(found[0][name], abs=1e-9 + (0.05 if spread > 10.0 else 0.0) * spread)
