"""Limits: wrong tables are config errors; arcs of axes close modulo 180 deg."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.axial import difference, in_arc, mean_axis, wrap
from pipeline.errors import ConfigError
from reports.limits import DEFAULT_LIMITS, Limit, load_limits


def test_default_limits_have_their_documented_values() -> None:
    bounds = {limit.quantity: (limit.low, limit.high) for limit in DEFAULT_LIMITS.limits}
    assert bounds["f1_hz"] == pytest.approx((0.98 * 535.5, 1.02 * 535.5))
    assert bounds["f2_hz"] == bounds["f1_hz"]
    assert bounds["split_hz"] == (-math.inf, 3.0)
    assert bounds["quality1"] == bounds["quality2"] == (1200.0, math.inf)
    assert bounds["quadrature_rate_dps"] == (-600.0, 600.0)
    assert bounds["rate_bias_dps"] == (-20.0, 20.0)
    assert (DEFAULT_LIMITS.rule.pass_at, DEFAULT_LIMITS.rule.fail_at) == (0.95, 0.05)


def test_a_file_and_its_table_give_the_same_limits(tmp_path: Path) -> None:
    path = tmp_path / "limits.toml"
    path.write_text("[rule]\npass_at = 0.9\n[limits.theta_deg]\nmin = 80\nmax = 100\n", encoding="utf-8")
    table = {"rule": {"pass_at": 0.9}, "limits": {"theta_deg": {"min": 80, "max": 100}}}
    assert load_limits(path) == load_limits(table)


@pytest.mark.parametrize(
    ("table", "match"),
    [
        ({"limits": {"split_hz": {"min": 3.0, "max": 1.0}}}, "crossed"),
        ({"limits": {"spilt_hz": {"max": 3.0}}}, "unknown quantity: 'spilt_hz'.*did you mean split_hz"),
        ({"limits": {"split_hz": {"maximum": 3.0}}}, "unknown key in limits.split_hz: 'maximum'.*did you mean max"),
        ({"limits": {"split_hz": {}}}, "limits nothing"),
        ({"limits": {"split_hz": 3.0}}, "limits.split_hz is not valid: 3.0; allowed: a table"),
        ({"limits": {"split_hz": {"max": float("nan")}}}, "limits.split_hz.max is not finite: nan"),
        ({"limits": {"split_hz": {"max": float("inf")}}}, "limits.split_hz.max is not finite: inf"),
        ({"limits": {"split_hz": {"max": "3 Hz"}}}, "limits.split_hz.max is not valid: '3 Hz'; allowed: a number"),
        ({"limits": {"split_hz": {"max": True}}}, "limits.split_hz.max is not valid: True; allowed: a number"),
        ({"limits": {"theta_deg": {"max": 40.0}}}, "not an arc"),
        ({"limits": {"theta_deg": {"min": -90.0, "max": 90.0}}}, "not an arc"),
        ({"limits": {"theta_deg": {"min": 40.0, "max": -40.0}}}, "crossed"),
        ({"limits": {}}, "no limits"),
        ({}, "no limits"),
        ({"limit": {"split_hz": {"max": 3.0}}}, "did you mean limits"),
        (
            {"rule": {"name": "guess"}, "limits": {"split_hz": {"max": 3.0}}},
            "'guess'; allowed: probability",
        ),
        ({"rule": {"pass_at": 0.05, "fail_at": 0.95}, "limits": {"split_hz": {"max": 3.0}}}, "crossed"),
        (
            {"rule": {"pass_at": 1.5}, "limits": {"split_hz": {"max": 3.0}}},
            "rule.pass_at is not valid: 1.5; allowed: a number above 0",
        ),
    ],
)
def test_wrong_limits_are_a_config_error_that_names_the_fault(table: dict[str, Any], match: str) -> None:
    with pytest.raises(ConfigError, match=match):
        load_limits(table)


@pytest.mark.parametrize("content", [b"[limits", b"\xff\xfe"])
def test_a_file_that_is_missing_or_not_toml_is_a_config_error(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "limits.toml"
    path.write_bytes(content)
    with pytest.raises(ConfigError, match="not TOML"):
        load_limits(path)
    with pytest.raises(ConfigError, match="no such file"):
        load_limits(tmp_path / "absent.toml")


@given(st.floats(-90, 90), st.floats(0.01, 179.9), st.floats(0.001, 0.999), st.integers(-3, 3))
def test_an_arc_contains_its_axes_modulo_180_deg(low: float, width: float, part: float, turns: int) -> None:
    limit = Limit("theta_deg", low, low + width)
    inside = low + part * width + 180.0 * turns
    outside = low + width + part * (180.0 - width) + 180.0 * turns
    assert limit.admits(np.array(inside))
    assert not limit.admits(np.array(outside)) or part * (180.0 - width) < 1e-9
    assert limit.margin(np.array(inside)) >= -1e-9
    assert limit.margin(np.array(outside)) <= 1e-9
    # The limits themselves conform in spite of the rounding of the modulo.
    assert limit.admits(wrap(low))
    assert limit.admits(wrap(low + width))


@given(st.floats(-1e4, 1e4), st.floats(-1e4, 1e4))
def test_the_difference_of_two_axes_is_the_smaller_angle(a: float, b: float) -> None:
    angle = float(difference(a, b))
    assert -90.0 < angle <= 90.0
    assert math.isclose(math.cos(2 * math.radians(angle)), math.cos(2 * math.radians(a - b)), abs_tol=1e-9)


def test_axes_at_both_sides_of_90_deg_are_close() -> None:
    assert difference(89.0, -89.0) == pytest.approx(-2.0)
    assert in_arc(-89.5, 89.0, -89.0)
    assert not in_arc(0.0, 89.0, -89.0)
    assert abs(mean_axis(np.array([89.0, -89.0]))) == pytest.approx(90.0)
    assert not in_arc(float("nan"), 0.0, 10.0)


def test_margin_is_1_in_the_middle_and_0_at_the_limits() -> None:
    two_sided = Limit("f1_hz", 520.0, 540.0)
    np.testing.assert_allclose(two_sided.margin(np.array([530.0, 520.0, 540.0, 550.0])), [1.0, 0.0, 0.0, -1.0])
    one_sided = Limit("quality1", 1200.0, math.inf)
    np.testing.assert_allclose(one_sided.margin(np.array([1200.0, 1800.0, 600.0])), [0.0, 0.5, -0.5])
    across = Limit("theta_deg", 80.0, 100.0)
    np.testing.assert_allclose(across.margin(np.array([90.0, -90.0, 80.0, -80.0, 70.0])), [1.0, 1.0, 0.0, 0.0, -1.0])
