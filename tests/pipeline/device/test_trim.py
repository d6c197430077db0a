"""Electrostatic trim: analytic limits, symmetries, voltage limits, and the remaining split."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.device.gyro import gyro_mechanics, split_hz, to_cartesian
from pipeline.device.operation.bias import rate_biases_dps
from pipeline.device.operation.trim import Target, trim, trim_batch, trimmed_physical
from pipeline.device.operation.trim_electrodes import Electrodes, gain_per_v2, standard_electrodes
from pipeline.errors import ConfigError

PAPER = np.array([534.5, 536.4, 590.3, 3.167e-4, 1.586e-4, 11.7e-4, -33.2, 0.4, 13.33, 28.6, 0.0386, 0.0007])
FOUR = standard_electrodes(gain_sd=0.0)


def rocking(physical):
    """K and C (2, 2) in the x, y frame."""
    m = gyro_mechanics(np.atleast_2d(physical))
    return m.stiffness[0, :2, :2], m.damping[0, :2, :2]


def split_of(physical):
    return split_hz(to_cartesian(np.atleast_2d(physical)))


def devices(seed, count, most_hz=4.0):
    random = np.random.default_rng(seed)
    p = np.tile(PAPER, (count, 1))
    p[:, 1] = p[:, 0] + random.uniform(0.05, most_hz, count)
    p[:, 6] = random.uniform(-90.0, 90.0, count)
    p[:, 7] = random.uniform(-0.6, 0.6, count)
    return p


def axis_distance(a, b):
    return np.abs((a - b + 90.0) % 180.0 - 90.0)


@given(
    theta=st.floats(-89.0, 90.0),
    split=st.floats(0.01, 4.0),
    volts=st.lists(st.floats(0.0, 15.0), min_size=4, max_size=4),
)
@settings(deadline=None)
def test_trim_subtracts_the_spring_matrices_and_nothing_else(theta, split, volts):
    device = PAPER.copy()
    device[1], device[6] = device[0] + split, theta
    (k, c), v = rocking(device), np.array(volts)
    beta = np.deg2rad(FOUR.azimuth_deg)
    n = np.stack([np.cos(beta), np.sin(beta)], axis=1)
    wanted = k - np.einsum("e,ei,ej->ij", np.array(FOUR.gain_per_v2) * v**2, n, n)
    after = trimmed_physical(device[None], v, FOUR)[0]
    k_after, c_after = rocking(after)
    np.testing.assert_allclose(k_after, wanted, atol=1e-10 * k[0, 0])
    np.testing.assert_allclose(c_after, c, atol=1e-9)
    np.testing.assert_array_equal(after[8:], device[8:])
    # And back: removing the voltages restores the device (theta within the resolution of a split in double precision).
    back = trimmed_physical(after[None], np.zeros(4), FOUR, present_v=v)[0]
    np.testing.assert_allclose(back[:6], device[:6], rtol=1e-9)
    assert axis_distance(back[6], device[6]) < 1e-7 / split


@pytest.mark.parametrize(("azimuths", "moved", "kept"), [((0.0, 90.0), 0, 1), ((45.0, 135.0), 1, 0)])
def test_orthogonal_pairs_on_the_axes_move_one_component_of_the_anisotropy_only(azimuths, moved, kept):
    pairs = standard_electrodes(azimuths)

    def anisotropy(p):
        k, _ = rocking(p)
        return np.array([(k[0, 0] - k[1, 1]) / 2.0, k[0, 1]])

    before = anisotropy(PAPER)
    for v in ([7.0, 0.0], [0.0, 7.0], [3.0, 9.0]):
        after = anisotropy(trimmed_physical(PAPER[None], np.array(v), pairs)[0])
        pull = 0.5 * pairs.gain_per_v2[0] * (v[0] ** 2 - v[1] ** 2)
        # K is 1e7 /s^2, so its last bit is 2e-9.
        assert abs(after[kept] - before[kept]) < 1e-6
        assert abs(after[moved] - (before[moved] - pull)) < 1e-6


def test_equal_voltages_lower_the_frequency_by_the_softening_law_and_leave_axes_and_anisotropy():
    volts = 6.0
    pairs = standard_electrodes((0.0, 90.0))
    after = trimmed_physical(PAPER[None], np.full(2, volts), pairs)[0]
    assert after[6] == pytest.approx(PAPER[6], abs=1e-9)
    squares = (after[1] ** 2 - after[0] ** 2, PAPER[1] ** 2 - PAPER[0] ** 2)
    assert squares[0] == pytest.approx(squares[1], rel=1e-9)
    # Each axis sees one pair: -0.03 Hz/V^2, up to the curvature of the square root.
    assert after[0] - PAPER[0] == pytest.approx(-0.03 * volts**2, rel=4e-3)


def test_a_pair_softens_the_up_down_mode_by_the_ratio_of_the_gains():
    pairs = standard_electrodes((45.0, 135.0))
    after = trimmed_physical(PAPER[None], np.array([5.0, 5.0]), pairs)[0]
    rocking_loss = (PAPER[0] ** 2 + PAPER[1] ** 2 - after[0] ** 2 - after[1] ** 2) / 2.0
    assert (PAPER[2] ** 2 - after[2] ** 2) / rocking_loss == pytest.approx(PAPER[9] / PAPER[8], rel=1e-9)


def test_known_gains_give_zero_split_with_at_most_two_pairs_and_the_least_frequency_shift():
    p = devices(1, 50)
    found = trim_batch(p, FOUR, Target(), np.ones((50, 4)))
    assert np.max(found.split_hz) < 1e-8
    assert np.max(np.count_nonzero(found.voltages_v > 1e-3, axis=1)) <= 2
    # What it costs by hand: |a| (|cos| + |sin|) of its direction, shared by the mean.
    e = np.deg2rad(2.0 * p[:, 6])
    size = np.pi * np.pi * 2.0 * (p[:, 1] ** 2 - p[:, 0] ** 2)
    mean = 2.0 * np.pi**2 * (p[:, 0] ** 2 + p[:, 1] ** 2) - size * (np.abs(np.cos(e)) + np.abs(np.sin(e)))
    np.testing.assert_allclose(found.physical[:, 0], np.sqrt(mean) / 2.0 / np.pi, rtol=1e-10)


@pytest.mark.parametrize("theta", [0.0, 90.0, -37.0])
def test_split_and_theta_reach_their_targets(theta):
    found = trim_batch(devices(2, 20), FOUR, Target(1.2, theta), np.ones((20, 4)))
    np.testing.assert_allclose(found.split_hz, 1.2, atol=1e-7)
    assert np.max(axis_distance(found.physical[:, 6], theta)) < 1e-6


def test_a_split_target_without_theta_keeps_the_axes():
    p = devices(3, 20)
    found = trim_batch(p, FOUR, Target(0.7), np.ones((20, 4)))
    np.testing.assert_allclose(found.split_hz, 0.7, atol=1e-7)
    assert np.max(axis_distance(found.physical[:, 6], p[:, 6])) < 1e-6


def test_a_theta_target_removes_the_quadrature_with_less_voltage_than_a_zero_split():
    p = devices(4, 30)
    ones = np.ones((30, 4))
    axis, split = trim_batch(p, FOUR, Target(None, 0.0), ones), trim_batch(p, FOUR, Target(), ones)
    quadrature = rate_biases_dps(axis.physical, 0.7, 0.0, "f1")["quadrature_rate_dps"]
    assert np.max(np.abs(quadrature)) < 1e-5
    assert np.all((axis.voltages_v**2).sum(axis=1) <= (split.voltages_v**2).sum(axis=1) * (1.0 + 1e-9))


@given(angle=st.floats(-180.0, 180.0), seed=st.integers(0, 50))
@settings(deadline=None, max_examples=30)
def test_rotating_device_electrodes_and_target_together_changes_no_voltage(angle, seed):
    p = devices(seed, 1)
    rotated = p.copy()
    rotated[0, 6] = 90.0 - (90.0 - (p[0, 6] + angle)) % 180.0
    pairs = standard_electrodes((10.0, 50.0, 95.0, 150.0), gain_sd=0.03)
    others = standard_electrodes(tuple(b + angle for b in pairs.azimuth_deg), gain_sd=0.03)
    ones = np.ones((1, 4))
    expected = trim_batch(p, pairs, Target(0.5, 20.0), ones)
    found = trim_batch(rotated, others, Target(0.5, 20.0 + angle), ones)
    np.testing.assert_allclose(found.voltages_v**2, expected.voltages_v**2, atol=1e-5)
    np.testing.assert_allclose(found.split_hz, expected.split_hz, atol=1e-8)


def test_the_remaining_split_decreases_as_the_voltage_limit_rises_and_vanishes_without_it():
    device = devices(5, 1, 4.0)
    device[0, 1] = device[0, 0] + 3.5
    left, missing, bound = [], [], []
    for most in (1.0, 3.0, 5.0, 7.0, 9.0, 11.0, 15.0):
        pairs = standard_electrodes(gain_sd=0.0, most_v=most)
        found = trim(device, pairs, Target(), np.random.default_rng(0))
        assert np.all((found.voltages_v >= 0.0) & (found.voltages_v <= most))
        left.append(float(split_of(found.after)[0]))
        missing.append(found.missing_hz)
        bound.append(bool(found.at_limit.any()))
    assert np.all(np.diff(left) <= 1e-9)
    assert left[0] > 3.4
    assert left[-1] < 1e-8
    assert bound == [value > 1e-6 for value in left]
    # What the plan says is missing is what is left.
    np.testing.assert_allclose(missing, left, rtol=1e-5, atol=1e-9)


def test_bounded_plan_is_the_best_of_a_fine_grid():
    device = devices(6, 1)
    device[0, 1] = device[0, 0] + 3.0
    pairs = standard_electrodes((0.0, 60.0, 120.0), gain_sd=0.0, most_v=7.0)
    for theta in (-80.0, -35.0, 5.0, 40.0, 71.0):
        device[0, 6] = theta
        best = trim(device, pairs, Target(), np.random.default_rng(0))
        axis = np.sqrt(np.linspace(0.0, 49.0, 25))
        grid = np.stack(np.meshgrid(axis, axis, axis), axis=-1).reshape(-1, 3)
        tried = split_of(trimmed_physical(np.tile(device, (grid.shape[0], 1)), grid, pairs))
        assert split_of(best.after)[0] <= np.min(tried) + 1e-3


@pytest.mark.parametrize("sd", [0.02, 0.08])
def test_the_remaining_split_has_the_relative_sd_of_the_gains(sd):
    # One pair along the upper axis does it alone, so |a'| = |a| |1 - k/<k>| and nothing else.
    device = PAPER.copy()
    device[6] = 90.0
    pairs = standard_electrodes(gain_sd=sd)
    draws = np.tile(device, (8000, 1))
    found = trim(draws, pairs, Target(), np.random.default_rng(3))
    left = split_of(found.after)
    # Half-normal: mean sd sqrt(2/pi) of 1.9 Hz; the sampling error of the mean is 0.76 sd / sqrt(8000), 0.011 of it.
    assert np.mean(left) == pytest.approx(1.9 * sd * np.sqrt(2.0 / np.pi), rel=0.05)
    assert found.missing_hz == pytest.approx(1.9 * sd**2, rel=0.05)
    assert np.quantile(left, 0.05) > 0.0


def test_the_trim_keeps_the_posterior_width_of_the_stiffness():
    random = np.random.default_rng(11)
    draws = np.tile(PAPER, (20_000, 1))
    draws[:, 1] += random.normal(0.0, 0.01, 20_000)
    draws[:, 6] += random.normal(0.0, 0.2, 20_000)
    found = trim(draws, FOUR, Target(), random)
    a = to_cartesian(found.after)
    components = np.stack([a[:, 1], a[:, 2]]) / 2.0 / np.pi
    # e = -split exp(2 i theta): sd 0.01 Hz along, 1.9 x 2 x 0.2 deg = 0.01326 Hz across the old axis.
    along = np.deg2rad(2.0 * PAPER[6])
    rotated = components.T @ np.array([[np.cos(along), -np.sin(along)], [np.sin(along), np.cos(along)]])
    np.testing.assert_allclose(rotated.std(axis=0), [0.01, 1.9 * np.deg2rad(0.4)], rtol=0.03)
    assert np.max(np.abs(rotated.mean(axis=0))) < 5.0 * 0.0133 / np.sqrt(20_000)


def test_each_round_of_trim_reduces_the_split_by_the_gain_error():
    p = devices(7, 40)
    pairs = standard_electrodes(gain_sd=0.05)
    gains = pairs.draw_gains(np.random.default_rng(9), 40)
    left = [trim_batch(p, pairs, Target(), gains, rounds).split_hz for rounds in (1, 2, 3)]
    before = p[:, 1] - p[:, 0]
    worst = np.max(np.abs(gains - 1.0)) + 2.0 * 0.05**2
    assert np.all(left[0] <= worst * np.sqrt(2.0) * before)
    assert np.all(left[1] <= 1.5 * worst * left[0])
    assert np.all(left[2] <= 1.5 * worst * left[1] + 1e-9)


def test_a_second_trim_starts_from_the_voltages_of_the_measurement():
    pairs = standard_electrodes(gain_sd=0.05)
    random = np.random.default_rng(2)
    truth, gains = devices(8, 1), pairs.draw_gains(np.random.default_rng(5), 1)
    volts = np.zeros(4)
    for _ in range(4):
        measured = trimmed_physical(truth, volts, pairs, gains)
        volts = trim(np.tile(measured, (100, 1)), pairs, Target(), random, volts).voltages_v
    assert split_of(trimmed_physical(truth, volts, pairs, gains))[0] < 1e-4
    known = trim_batch(truth, pairs, Target(), gains, 4)
    np.testing.assert_allclose(known.voltages_v[0], volts, atol=1e-6)


def test_a_device_on_target_needs_no_voltage():
    device = PAPER.copy()
    device[1] = device[0]
    np.testing.assert_allclose(trim_batch(device[None], FOUR, Target(), np.ones((1, 4))).voltages_v, 0.0, atol=1e-4)
    same = trim_batch(PAPER[None], FOUR, Target(PAPER[1] - PAPER[0], PAPER[6]), np.ones((1, 4)))
    np.testing.assert_allclose(same.voltages_v, 0.0, atol=1e-3)


def test_one_pair_reduces_the_split_to_its_projection():
    # Only exp(2 i beta) is reachable: at 45 deg from the upper axis nothing helps, at 20 deg sin(40 deg) is left.
    for off, left in ((45.0, 1.0), (20.0, np.sin(np.deg2rad(40.0))), (0.0, 0.0)):
        pair = standard_electrodes((PAPER[6] + 90.0 + off,), gain_sd=0.0)
        found = trim(PAPER[None], pair, Target(), np.random.default_rng(0))
        assert split_of(found.after)[0] == pytest.approx(1.9 * left, rel=3e-3, abs=1e-8)


def test_gains_are_drawn_with_their_mean_and_sd():
    pairs = standard_electrodes(gain_sd=0.2)
    gains = pairs.draw_gains(np.random.default_rng(0), 50_000)
    np.testing.assert_allclose(gains.mean(axis=0), 1.0, atol=5.0 * 0.2 / np.sqrt(50_000))
    np.testing.assert_allclose(gains.std(axis=0), 0.2, rtol=0.02)
    assert gain_per_v2(-0.03, 535.5) == pytest.approx(1268.4, rel=1e-3)


@pytest.mark.parametrize(
    ("attempt", "message"),
    [
        (lambda: Electrodes((), ()), "azimuth and a gain"),
        (lambda: Electrodes((0.0,), (-1.0,)), "gains must be positive"),
        (lambda: Electrodes((0.0,), (1.0,), most_v=0.0), "limit of the trim voltages"),
        (lambda: Target(None, None), "split or an angle"),
        (lambda: Target(-1.0), "must not be negative"),
        (lambda: trim(PAPER, FOUR, Target(), np.random.default_rng(0)), "needs parameters"),
        (lambda: trim(PAPER[None] * np.nan, FOUR, Target(), np.random.default_rng(0)), "needs parameters"),
        (lambda: trim(PAPER[None], FOUR, Target(), np.random.default_rng(0), np.array([99.0, 0, 0, 0])), "present"),
        (lambda: trimmed_physical(PAPER[None], np.zeros(3), FOUR), "does not fit"),
        (lambda: trimmed_physical(PAPER[None], np.full(4, 200.0), FOUR), "electrostatic pull-in"),
        (lambda: trim_batch(PAPER[None], FOUR, Target(), np.ones((1, 4)), 0), "at least 1"),
        (lambda: trim_batch(PAPER[None], FOUR, Target(), np.ones((2, 4))), "gains have the wrong shape"),
    ],
)
def test_impossible_arguments_are_a_config_error(attempt, message):
    with pytest.raises(ConfigError, match=message):
        attempt()
