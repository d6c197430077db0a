"""The first order of a population against devices drawn in full."""

import msgspec
import numpy as np
import pytest

from pipeline.learning.lot.gyro import COORDINATES, NEEDED, coordinates, parameters, propagated
from populations.draw import draw
from populations.layout import die_centres
from populations.linear import curvature, linearized
from populations.spec import load_spec

SPEC = load_spec(None)


@pytest.fixture(scope="module")
def linear():
    x, y = die_centres(SPEC.wafer).T
    return linearized(SPEC, x, y, "package", coordinates)


def test_coordinates_and_back():
    made = draw(SPEC, 5, 0, 40).true
    back = parameters(coordinates(made))
    for name in NEEDED:
        assert back[name] == pytest.approx(made[name], rel=1e-10, abs=1e-12)


def test_covariance_of_coordinates_is_that_of_draws():
    made = {name: values[:1] for name, values in draw(SPEC, 5, 3, 1).true.items()}
    sd = {name: np.full(1, 1e-4 * abs(float(made[name][0])) + 1e-9) for name in NEEDED}
    # f1 and f2 enter beside the split, so that each is varied alone.
    g = np.random.default_rng(0)
    n = 40_000
    drawn = {name: made[name] + sd[name] * g.standard_normal(n) for name in NEEDED}
    found = np.cov(coordinates(drawn).T)
    wanted = propagated(made, sd)[0]
    size = np.sqrt(np.outer(np.diag(wanted), np.diag(wanted)))
    assert found / size == pytest.approx(wanted / size, abs=5.0 / np.sqrt(n))


def test_a_nominal_device_is_the_base_without_irregularities(linear):
    alone = msgspec.structs.replace(SPEC, irregularity={})
    made = draw(alone, 0, 0, 1).true
    assert linear.nominal[0] == pytest.approx(coordinates(made)[0], rel=1e-12, abs=1e-15)


def test_streams_and_patterns_have_the_names_of_their_irregularities(linear):
    names = {stream.name for stream in linear.streams}
    assert {"spring_thickness.wedge", "electrode_gap.wafer", "damping.anchor", "die_attach_stress.package"} <= names
    field = next(stream for stream in linear.streams if stream.name == "spring_thickness.field")
    assert field.field_mm == 15.0
    # Sidewall tilt: e = a T^2 exp(2 i phi), nothing else.
    pattern = linear.patterns["sidewall_tilt"]
    x, y = die_centres(SPEC.wafer).T / 50.0
    tilt = SPEC.irregularity["sidewall_tilt"]
    size = 0.01 * tilt["anisotropy_pct_per_deg2"] * tilt["edge_deg"] ** 2
    assert pattern[:, COORDINATES.index("anisotropy_x")] == pytest.approx(size * (x * x - y * y), rel=2e-2, abs=2e-6)
    assert np.abs(pattern[:, COORDINATES.index("ln_damping")]).max() < 1e-6


def test_a_leak_is_a_share_with_a_mean(linear):
    (leak,) = linear.switched
    own = SPEC.irregularity["lid_leak"]
    assert leak.share == pytest.approx(own["fraction"], abs=1e-6)
    k = COORDINATES.index("ln_updown_damping")
    # 1/Q = p / Q_gas + the other losses, of the up-down mode.
    gas = 1.0 / 430.0 - 1.0 / 9000.0 - 1e-6
    assert leak.mean[0, k] == pytest.approx(np.log(1.0 + 430.0 * gas * (np.exp(own["ln_mean"]) - 1.0)), rel=1e-6)


def test_first_order_gives_the_covariance_of_drawn_devices(linear):
    """Total sd of each coordinate over 3000 devices of own lots; 5 % is 2.7 sd of a sample sd, and what curvature adds."""
    wafer = msgspec.structs.replace(SPEC.wafer, lots_per_batch=1000, wafers_per_lot=1)
    spec = msgspec.structs.replace(
        SPEC, wafer=wafer, irregularity={k: v for k, v in SPEC.irregularity.items() if k != "lid_leak"}
    )
    made = draw(spec, 7, 0, 3000)
    x, y = made.die_x_mm, made.die_y_mm
    near = linearized(spec, x, y, "package", coordinates)
    moved = coordinates(made.true) - near.base
    variance = sum(np.mean(np.sum(stream.columns**2, axis=2), axis=0) for stream in near.streams)
    # Lots are shared by three devices each.
    assert np.std(moved, axis=0) / np.sqrt(variance) == pytest.approx(np.ones(12), abs=0.06)


def test_what_the_first_order_leaves_is_small(linear):
    x, y = die_centres(SPEC.wafer).T
    left = curvature(SPEC, x, y, "package", coordinates, 1)
    variance = sum(np.mean(np.sum(stream.columns**2, axis=2), axis=0) for stream in linear.streams)
    assert np.all(np.std(left, axis=0) < 0.08 * np.sqrt(variance))
