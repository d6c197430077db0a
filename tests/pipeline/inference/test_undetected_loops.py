"""Compiled loops and single precision of the scores of effects, against plain arithmetic in double precision."""

from dataclasses import replace

import numpy as np
import pytest

from pipeline.arrays import real_parts
from pipeline.device.effects import cubic_stiffness
from pipeline.device.force_law import Laws, Points, force_along, in_single, single_force_along
from pipeline.device.mechanics import Mechanics, modes_of
from pipeline.experiment.excitation import Chirp, drive_samples
from pipeline.experiment.instrument import AntiAlias, Instrument
from pipeline.inference.screening.compressed import BandData, nuisance_basis
from pipeline.inference.screening.inband import make_band
from pipeline.inference.screening.undetected.bounds import (
    Candidates,
    EffectEvidence,
    Projection,
    judged,
    judged_together,
)
from pipeline.inference.screening.undetected.device import _judged_of, _Posed
from pipeline.inference.screening.undetected.force_loops import end_sums, first_harmonic, sums_of_squares, weighted_sums
from pipeline.inference.screening.undetected.library import Probe, members_of, probes_of
from pipeline.inference.screening.undetected.loops import respond
from pipeline.inference.screening.undetected.motions import _cyclic
from pipeline.inference.screening.undetected.narrow_band import WHOLE_TURN, grid_of, harmonics, waves
from pipeline.inference.screening.undetected.parity import kind_of
from pipeline.inference.screening.undetected.position_modes import PositionModes
from pipeline.inference.screening.undetected.rows import take_out_hum, white_products
from pipeline.inference.screening.undetected.scan_bounds import _least_above

RATE = 10_000.0


@pytest.mark.parametrize(("kind", "rtol"), [(np.float32, 2e-6), (np.float64, 1e-6)])
@pytest.mark.parametrize(("first", "count"), [(0, 7), (3, 7), (2, 3), (5, 4)])
def test_a_written_first_harmonic_is_that_of_the_values(kind, rtol, first, count):
    random = np.random.default_rng(0)
    values = random.standard_normal((2, 5, 7)).astype(kind)
    counted = np.array([[1, 1, 0, 1, 0, 0, 1], [1] * 7], dtype=np.float32)
    out = np.full((2, 3, 7), 9.0, dtype=np.complex64)
    turns = waves(WHOLE_TURN, (1,), kind is np.float32).T[None] * (2.0 / WHOLE_TURN.count)
    own = np.ascontiguousarray(values[..., :count])
    first_harmonic(own, np.ascontiguousarray(turns), counted, first, 1, out.view(np.float32))
    (plain,) = harmonics(values.astype(np.float64).reshape(2, -1), WHOLE_TURN, 1)
    plain = np.roll(np.where(np.arange(7) < count, counted * plain, 0.0), first, axis=1)
    np.testing.assert_allclose(out[:, 1], plain, rtol=rtol, atol=rtol)
    assert (out[:, ::2] == 9.0).all()


@pytest.mark.parametrize("kind", [np.float32, np.float64])
@pytest.mark.parametrize("terms", [1, 2, 5, 6])
def test_weighted_sums_are_written_or_added(kind, terms):
    random = np.random.default_rng(8)
    values, weights = random.standard_normal((2, terms, 9)), random.standard_normal((2, terms, 3))
    out = np.ones((2, 5, 7), dtype=kind)
    for own, fresh, plain in ((weights, False, 1.0), (weights[:1], True, 0.0)):
        weighted_sums(values.astype(np.float32), own.astype(kind), 1, fresh, out)
        plain = plain + np.swapaxes(own, 1, 2) @ values[..., :7]
        np.testing.assert_allclose(out[:, 1:4], plain, rtol=2e-6, atol=2e-6)
        assert (out[:, [0, 4]] == 1.0).all()


def test_sums_of_squares_are_the_same_whichever_point_comes_first():
    random = np.random.default_rng(9)
    values, counted = random.standard_normal((2, 3, 23)).astype(np.float32), np.ones((2, 23), dtype=np.float32)
    counted[:, 12:17] = 0.0
    sums = {}
    for first, count in ((0, 23), (5, 23), (17, 18)):
        sums[first] = np.empty((2, 3))
        ordered = [np.ascontiguousarray(np.roll(each, -first, axis=-1)) for each in (values, counted)]
        sums_of_squares(*ordered, first, count, sums[first])
    plain = np.sum((values * counted[:, None]).astype(np.float64) ** 2, axis=-1)
    np.testing.assert_allclose(sums[0], plain, rtol=1e-12)
    np.testing.assert_array_equal(sums[5], sums[0])
    np.testing.assert_array_equal(sums[17], sums[0])


@pytest.mark.parametrize("damping", [1.0, 1e3])
def test_sums_up_to_the_end_of_a_record_count_the_decay_from_each_point(damping):
    """A strongly damped mode keeps the last points only; factors counted from the start would overflow."""
    band = make_band(drive_samples(Chirp(), RATE)[:3000], Instrument(), 500.0, 560.0)
    grid, random = grid_of(band), np.random.default_rng(10)
    exponents = -damping * np.array([[1.0, 0.5, 2.0]]) + 1j * np.array([[30.0, -40.0, 0.0]])
    a = (random.standard_normal((1, 4, grid.points)) + 1j).astype(np.complex64)
    out = np.empty((1, 3, 4), dtype=np.complex64)
    end_sums(a, *grid.decays(exponents), out)
    left = band.samples / band.sample_rate_hz - grid.time_s
    plain = np.exp(exponents[..., None] * left) @ a.swapaxes(1, 2)
    np.testing.assert_allclose(out, plain, atol=1e-5 * abs(plain).max())


def test_the_points_that_are_used_follow_each_other_on_a_cyclic_grid():
    assert _cyclic(np.array([0, 6, 7, 9]), 10) == (6, 5)
    assert _cyclic(np.array([2, 3]), 10) == (2, 2)
    assert _cyclic(np.array([4]), 10) == (4, 1)
    assert _cyclic(np.arange(10), 10)[1] == 10
    assert _cyclic(np.array([], dtype=int), 10) == (0, 0)


def test_the_response_is_the_transfer_times_the_force_less_the_motion_at_the_end():
    random = np.random.default_rng(1)
    bins, points, below = 9, 16, 4

    def drawn(*shape):
        return random.standard_normal(shape) + 1j * random.standard_normal(shape)

    force, ringing, gain = drawn(4, points), random.standard_normal((2, 3, 2)), drawn(3, 3, 2)
    rows, omega, antialias = np.array([[2, -1, 0], [-1, 3, 1]]), np.linspace(3.0, 4.0, bins), drawn(bins)
    poles = np.array([-0.1 + 3.2j, -0.02 + 3.6j, -1.0 + 5.0j])
    out = np.empty((2, 2, 2 * bins))
    single = [real_parts(each).astype(np.float32) for each in (antialias, gain)]
    envelopes, end = force.astype(np.complex64), ringing.astype(np.float32)
    respond(envelopes, rows, below, end, omega, single[0], real_parts(poles), single[1], out)
    transfer = antialias * sum(
        g[..., None] / (1j * omega - p) + g.conj()[..., None] / (1j * omega - p.conj()) for g, p in zip(gain, poles)
    )
    ordered = np.concatenate([force[:, points - below :], force[:, : bins - below]], axis=1)
    acting = np.where(rows[..., None] >= 0, ordered[rows], 0.0)
    plain = np.einsum("caw,kcw->kaw", transfer, acting - ringing[..., :1] - 1j * omega * ringing[..., 1:])
    scale = np.abs(plain).max()
    np.testing.assert_allclose(out, np.concatenate([plain.real, plain.imag], axis=-1), atol=1e-6 * scale)


@pytest.mark.parametrize("samples", [30_000, 2999])
def test_hum_lines_are_taken_out_whether_or_not_they_fall_on_bins(samples):
    instrument = Instrument(antialias=AntiAlias())
    band = make_band(drive_samples(Chirp(), RATE)[:samples], instrument, 400.0, 700.0)
    nuisance = nuisance_basis(band, 60.0)
    assert nuisance.shape[1] >= 8
    rows = np.random.default_rng(2).standard_normal((3, 2, nuisance.shape[0]))
    plain = rows - (rows @ nuisance) @ nuisance.T
    take_out_hum(rows, nuisance)
    np.testing.assert_allclose(rows, plain, atol=1e-9)


def test_white_products_are_those_with_the_fit_and_within_an_effect():
    random = np.random.default_rng(3)
    band = make_band(drive_samples(Chirp(), RATE)[:3000], Instrument(), 500.0, 560.0)
    item = BandData(band, np.zeros((2, band.bins.size), complex), np.zeros((2 * band.bins.size, 0)))
    rows, fit, effects = (
        random.standard_normal((20, 2, 2 * band.bins.size)),
        5,
        np.array([0, 0, 2, 1, 1, 1, 2, *[3] * 8]),
    )
    variance = np.repeat([[4.0], [9.0]], band.bins.size, axis=1)
    flat = (rows * np.sqrt(2.0 / band.samples / variance[:, :1])).reshape(20, -1)
    found, plain = white_products(rows, fit, effects, item, variance), flat @ flat.T
    same = effects[:, None] == effects
    np.testing.assert_allclose(found[:fit], plain[:fit], rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(found[:, :fit], plain[:, :fit], rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(found[fit:, fit:][same], plain[fit:, fit:][same], rtol=1e-12, atol=1e-12)


def test_small_changes_move_the_modes_as_their_derivatives_say():
    random = np.random.default_rng(4)
    stiffness = np.diag([1.0e7, 1.1e7, 1.4e7]) + 1e5 * np.ones((3, 3))
    damping, change = np.diag([2.0, 1.0, 8.0]) + 0.3, random.standard_normal((3, 3))
    eye, none = np.eye(3)[None], np.zeros((1, 3, 3))

    def mechanics(step):
        return Mechanics(damping[None], step * (change - change.T)[None], stiffness[None] + step * 1e3, eye, none, eye)

    own = mechanics(0.0)
    near = modes_of(own).poles
    modes = PositionModes.of(own, near)
    state = np.zeros((1, 1, 6, 6))
    state[0, 0, 3:, :3], state[0, 0, 3:, 3:] = -1e3, change.T - change
    poles, parts = modes.moved(state)
    step = 1e-3
    ahead, behind = (PositionModes.of(mechanics(sign * step), near) for sign in (1.0, -1.0))
    np.testing.assert_allclose(poles[:, 0], (ahead.poles - behind.poles) / (2.0 * step), rtol=1e-6)
    plain = (ahead.parts - behind.parts) / (2.0 * step)
    np.testing.assert_allclose(parts[:, 0], plain, atol=1e-5 * np.abs(plain).max())


def test_laws_are_right_in_single_precision():
    random = np.random.default_rng(5)
    q, qd, u = (size * random.standard_normal((k, 50)) for k, size in ((3, 1e-4), (3, 0.3), (2, 1.0)))
    matrix = random.standard_normal((3, 3))
    laws = Laws(matrix, matrix, random.standard_normal((3, 2)), random.standard_normal((2, 3)), 5.0, 5.0, 2)
    motion = Points(np.linspace(0.0, 3.0, 50), q, qd, u)
    found = [probe for probe in probes_of(True, "force") if kind_of(probe).single]
    assert len(found) >= 11
    for probe in found:
        p = probe.at(probe.member.scale)
        exact, rough = force_along(probe.effect.force, motion, p, laws), np.empty((3, 50), dtype=np.float32)
        single_force_along(probe.effect.force, motion.single, p, in_single(laws), rough)
        assert np.linalg.norm(rough - exact) < 1e-5 * np.linalg.norm(exact), probe.effect.name


def _cancels(t, q, qd, u, p, laws, out):
    """A cubic stiffness as a difference of two large numbers."""
    out[0] -= 1e4 * ((1.0 + 1e-4 * p[0] * q[0] * q[0] * q[0]) - 1.0)


def test_a_law_that_cancels_its_digits_stays_in_double_precision():
    effect = cubic_stiffness.EFFECT
    (member,) = members_of(effect)
    assert kind_of(Probe(effect, member, 0, 1)).single
    kind = kind_of(Probe(replace(effect, force=_cancels, potential=None), member, 0, 1))
    assert kind.order == 1
    assert not kind.single


@pytest.fixture
def evidence():
    """Three devices with two effects, one of one and one of two columns."""
    random = np.random.default_rng(6)
    columns = random.standard_normal((3, 40, 9))
    products = np.swapaxes(columns, 1, 2) @ columns
    candidates = Candidates(("b", "a", "a"), np.full(3, -2.0), np.full(3, 3.0))
    return [
        EffectEvidence(own, Projection.of(own[:5, :5], random.standard_normal((4, 5))), candidates, dof)
        for own, dof in zip(products, (50.0, 70.0, 90.0))
    ]


def _assert_equal(one, other):
    assert one.effects == other.effects == ("a", "b")
    for name in ("p_values", "explained", "bounds"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


def test_devices_that_are_judged_together_have_the_numbers_of_each_alone(evidence):
    for together, own in zip(judged_together(evidence), evidence):
        _assert_equal(together, judged(own))


def test_a_device_that_cannot_be_judged_does_not_change_the_others(evidence):
    every = (evidence[0], replace(evidence[1], products=evidence[1].products[:-1, :-1]), evidence[2])
    posed = [_Posed(one, judged(evidence[0]), ("q",)) for one in every]
    first, failed, last = _judged_of(posed)
    assert isinstance(failed, ValueError)
    _assert_equal(first, judged(evidence[0]))
    _assert_equal(last, judged(evidence[2]))


def test_the_quantile_of_a_scan_is_the_least_value_with_its_share_below():
    random = np.random.default_rng(7)
    values, weight = random.standard_normal((4, 60)), random.random(60)
    values[0, 3] = np.inf
    weight /= weight.sum()

    def quantile(values, weight, share):
        # A scan of another effect on either side, whose values are larger.
        first = np.array([0, 2, 2 + weight.size])
        beside = np.full((values.shape[0], 2), 1e3)
        out = np.empty((3, values.shape[0]))
        every = np.concatenate([beside, values, beside], axis=1)
        _least_above(every, first, np.concatenate([np.ones(2), weight, np.ones(2)]), np.array([0.0, share, 0.0]), out)
        np.testing.assert_array_equal(out[[0, 2]], 1e3)
        return out[1]

    for own, found in zip(values, quantile(values, weight, 0.05)):
        order = np.argsort(own)
        assert found == own[order][np.argmax(np.cumsum(weight[order]) >= 0.95)]
    assert np.isnan(quantile(np.full((1, 3), np.nan), np.full(3, 1.0 / 3.0), 0.05)).all()
    assert np.isnan(quantile(np.array([[1.0, np.nan, 2.0]]), np.full(3, 1.0 / 3.0), 0.05)).all()
    np.testing.assert_array_equal(quantile(values, np.ones(60), 0.0), values.max(axis=1))
    np.testing.assert_array_equal(quantile(np.zeros((1, 60)), weight, 0.05), [0.0])
