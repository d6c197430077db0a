"""The lattice is batch least squares: at every order, after every sample, whatever the data started from."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.experiment.instrument import AntiAlias
from pipeline.experiment.record import Record
from pipeline.identification.arx import ArxModel, fit_arx
from pipeline.identification.bandpass import bandpass, window_slice
from pipeline.identification.failure import IdentificationError
from pipeline.identification.lattice import advance, arx_of, fit_arx_lattice, start_lattice
from pipeline.identification.modes import modes_of, to_continuous
from pipeline.identification.route import RouteResult, route_from_modes

RATE = 10_000.0


def batch(y: np.ndarray, u: np.ndarray, order: int, ridge_v2: np.ndarray) -> tuple[ArxModel, np.ndarray]:
    """(*) of the lattice by numpy.linalg.lstsq, the ridge as further rows; with the residual energy."""
    senses, w = y.shape[1], np.hstack([y, u])
    x = np.hstack([w[order - k : len(w) - k] for k in range(1, order + 1)])
    scale = np.linalg.norm(x, axis=0)
    rows = np.vstack([x, np.diag(np.tile(np.sqrt(ridge_v2), order))]) / scale
    target = np.vstack([y[order:], np.zeros((x.shape[1], senses))])
    theta = np.linalg.lstsq(rows, target, rcond=1e-18)[0]
    residual = target - rows @ theta
    lagged = (theta / scale[:, None]).reshape(order, -1, senses).transpose(0, 2, 1)
    b = np.concatenate([np.zeros((1, senses, u.shape[1])), lagged[:, :, senses:]])
    return ArxModel(-lagged[:, :, :senses], b, np.zeros((senses, senses))), residual.T @ residual


def predictions(model: ArxModel, y: np.ndarray, u: np.ndarray) -> np.ndarray:
    n = model.order
    out = np.zeros((len(y) - n, y.shape[1]))
    for k in range(1, n + 1):
        out += u[n - k : len(u) - k] @ model.B[k].T - y[n - k : len(y) - k] @ model.A[k - 1].T
    return out


def wandering_data(seed: int, samples: int, senses: int = 2, drives: int = 2) -> tuple[np.ndarray, np.ndarray]:
    """Well conditioned data that are far from rest at the first sample and not stationary."""
    rng = np.random.default_rng(seed)
    u = rng.normal(size=(samples, drives))
    y = 5.0 + np.cumsum(0.3 * rng.normal(size=(samples, senses)), axis=0) + u @ rng.normal(size=(drives, senses))
    return y, u


def windowed(record: Record) -> tuple[np.ndarray, np.ndarray]:
    both = bandpass(np.hstack([record.sense_v, record.drive_v]), RATE)
    window = both[window_slice(both[:, :2], RATE)]
    return window[:, :2], window[:, 2:]


def route(model: ArxModel) -> RouteResult:
    return route_from_modes(to_continuous(modes_of(model, RATE), RATE), AntiAlias())


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    senses=st.integers(1, 3),
    drives=st.integers(1, 2),
    order=st.integers(1, 6),
    relative_ridge=st.sampled_from([1e-20, 1e-6, 1.0]),
)
def test_lattice_is_unwindowed_least_squares_at_every_order(
    seed: int, senses: int, drives: int, order: int, relative_ridge: float
) -> None:
    """Also with a ridge that matters: the two prefixes are exact, not approximations that die out."""
    y, u = wandering_data(seed, 120, senses, drives)
    ridge = relative_ridge * np.sum(np.hstack([y, u]) ** 2, axis=0)
    lattice = advance(start_lattice(senses, drives, order, ridge), y, u)
    for p in range(1, order + 1):
        found, (expected, energy) = arx_of(lattice, p), batch(y, u, p, ridge)
        np.testing.assert_allclose(found.A, expected.A, rtol=0, atol=1e-9)
        np.testing.assert_allclose(found.B, expected.B, rtol=0, atol=1e-9)
        np.testing.assert_allclose(lattice.energy[p], energy, rtol=0, atol=1e-9 * np.trace(energy))


def test_lattice_is_least_squares_after_every_sample() -> None:
    """Fed one sample at a time, stopped anywhere."""
    y, u = wandering_data(3, 60)
    ridge = np.full(4, 1e-18)
    lattice = start_lattice(2, 2, 3, ridge)
    for t in range(60):
        lattice = advance(lattice, y[t : t + 1], u[t : t + 1])
        if t + 1 > 20:
            expected, _ = batch(y[: t + 1], u[: t + 1], 3, ridge)
            np.testing.assert_allclose(arx_of(lattice).A, expected.A, rtol=0, atol=1e-9)


@settings(max_examples=20, deadline=None)
@given(cuts=st.lists(st.integers(1, 199), min_size=0, max_size=6, unique=True))
def test_how_the_samples_are_cut_into_pieces_changes_nothing(cuts: list[int]) -> None:
    y, u = wandering_data(4, 200)
    start = start_lattice(2, 2, 8, np.full(4, 1e-18))
    whole = arx_of(advance(start, y, u))
    pieces = start
    for a, b in zip([0, *sorted(cuts)], [*sorted(cuts), 200]):
        pieces = advance(pieces, y[a:b], u[a:b])
    assert np.array_equal(arx_of(pieces).A, whole.A)
    assert np.array_equal(arx_of(pieces).B, whole.B)
    assert start.samples == 0


def test_coefficient_predictions_match_batch_to_1e_6_at_order_40(at_60_db: Record) -> None:
    """On the raw record with a little white noise on the drives, which makes the regressors well conditioned."""
    rng = np.random.default_rng(0)
    y = at_60_db.sense_v[8000:20_000]
    u = at_60_db.drive_v[8000:20_000] + 1e-2 * rng.normal(size=(12_000, 2))
    ridge = 1e-20 * np.sum(np.hstack([y, u]) ** 2, axis=0)
    expected = predictions(batch(y, u, 40, ridge)[0], y, u)
    found = predictions(fit_arx_lattice(y, u, 40, 1e-20), y, u)
    assert np.abs(found - expected).max() < 1e-6 * np.abs(expected).max()


@pytest.mark.parametrize(("order", "theta_deg", "split_hz"), [(10, 1e-4, 1e-6), (40, 1e-3, 1e-5), (80, 1e-2, 1e-4)])
def test_route_by_lattice_is_route_by_batch_on_bandpassed_data(
    at_60_db: Record, order: int, theta_deg: float, split_hz: float
) -> None:
    """Regressors of condition 1e17, order up to 80."""
    y, u = windowed(at_60_db)
    ridge = 1e-16 * np.sum(np.hstack([y, u]) ** 2, axis=0)
    found, expected = route(fit_arx_lattice(y, u, order)), route(batch(y, u, order, ridge)[0])
    np.testing.assert_allclose(found.axes.theta_deg, expected.axes.theta_deg, rtol=0, atol=theta_deg)
    assert abs(found.arx_split_hz - expected.arx_split_hz) < split_hz


def test_lattice_and_fast_batch_are_one_estimator_at_the_same_ridge(at_60_db: Record) -> None:
    y, u = windowed(at_60_db)
    found, fast = route(fit_arx_lattice(y, u, 40, 1e-12)), route(fit_arx(y, u, 40, 1e-12))
    assert abs(found.axes.mean_deg - fast.axes.mean_deg) < 0.01
    assert abs(found.arx_split_hz - fast.arx_split_hz) < 1e-5


def test_no_initial_or_final_condition_biases_the_modes(silent_noise: Record) -> None:
    """ "non-zero initial and final conditions in the data introduce no bias" (Section 4.1): any stretch will do."""
    y, u = windowed(silent_noise)
    for start, stop in ((0, 8000), (5000, 12_000)):
        found = to_continuous(modes_of(fit_arx_lattice(y[start:stop], u[start:stop], 20), RATE), RATE)
        np.testing.assert_allclose(found.frequency_hz, [534.5, 536.4, 590.3], rtol=1e-6)


def test_order_of_the_channels_and_their_units_do_not_matter(at_60_db: Record) -> None:
    y, u = windowed(at_60_db)
    y, u = y[:6000], u[:6000]
    plain = fit_arx_lattice(y, u, 12, 1e-14)
    other = fit_arx_lattice(y[:, ::-1] * [1e3, 1.0], u[:, ::-1] * [1.0, 1e-4], 12, 1e-14)
    a = to_continuous(modes_of(plain, RATE), RATE)
    b = to_continuous(modes_of(other, RATE), RATE)
    np.testing.assert_allclose(b.poles, a.poles, rtol=1e-8)


def test_what_the_lattice_cannot_take_is_refused() -> None:
    y, u = wandering_data(0, 50)
    lattice = start_lattice(2, 2, 4, np.ones(4))
    with pytest.raises(IdentificationError, match="channels of the lattice"):
        advance(lattice, y[:, :1], u)
    with pytest.raises(IdentificationError, match="not finite"):
        advance(lattice, y * np.nan, u)
    with pytest.raises(IdentificationError, match="no model of this order"):
        arx_of(advance(lattice, y[:10], u[:10]))
    with pytest.raises(IdentificationError, match="no model of this order"):
        arx_of(advance(lattice, y, u), 5)
    with pytest.raises(IdentificationError, match="order and a ridge"):
        start_lattice(2, 2, 4, np.zeros(4))
    with pytest.raises(IdentificationError, match="silent"):
        fit_arx_lattice(y, u * [1.0, 0.0], 4)


def test_lattice_state_is_a_value() -> None:
    """Two continuations of one state do not see each other."""
    y, u = wandering_data(1, 100)
    half = advance(start_lattice(2, 2, 4, np.full(4, 1e-18)), y[:50], u[:50])
    before = dataclasses.astuple(half)
    one = arx_of(advance(half, y[50:], u[50:]))
    advance(half, -y[50:], u[50:])
    again = arx_of(advance(half, y[50:], u[50:]))
    assert np.array_equal(one.A, again.A)
    for a, b in zip(before, dataclasses.astuple(half)):
        assert np.array_equal(a, b)
