"""ARX fits against numpy's least squares, and what a change of units or of channels may do to them."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.experiment.instrument import AntiAlias
from pipeline.experiment.record import Record
from pipeline.identification.arx import ArxModel, fit_arx, gram_matrix
from pipeline.identification.bandpass import bandpass, window_slice
from pipeline.identification.failure import IdentificationError
from pipeline.identification.modes import modes_of, to_continuous
from pipeline.identification.route import RouteResult, route_from_modes

RATE = 10_000.0


def regressors(w: np.ndarray, order: int) -> np.ndarray:
    """w(t-1), .., w(t-n) side by side, t = n..N-1."""
    return np.hstack([w[order - k : len(w) - k] for k in range(1, order + 1)])


def fit_arx_lstsq(y: np.ndarray, u: np.ndarray, order: int, ridge: float = 0.0) -> ArxModel:
    """The oracle: numpy.linalg.lstsq; a ridge enters as further rows, so no product is ever squared."""
    senses = y.shape[1]
    x, target = regressors(np.hstack([y, u]), order), y[order:]
    scale = np.linalg.norm(x, axis=0)
    if ridge:
        x = np.vstack([x, np.sqrt(ridge) * np.diag(scale)])
        target = np.vstack([target, np.zeros((scale.size, senses))])
    theta, *_ = np.linalg.lstsq(x / scale, target, rcond=None)
    lagged = (theta / scale[:, None]).reshape(order, -1, senses).transpose(0, 2, 1)
    b = np.concatenate([np.zeros((1, senses, u.shape[1])), lagged[:, :, senses:]])
    return ArxModel(-lagged[:, :, :senses], b, np.zeros((senses, senses)))


def prefiltered(record: Record) -> tuple[np.ndarray, np.ndarray]:
    both = bandpass(np.hstack([record.sense_v, record.drive_v]), RATE)
    window = both[window_slice(both[:, :2], RATE)]
    return window[:, :2], window[:, 2:]


def route(model: ArxModel) -> RouteResult:
    return route_from_modes(to_continuous(modes_of(model, RATE), RATE), AntiAlias())


def random_system(seed: int = 0, samples: int = 3000) -> tuple[np.ndarray, np.ndarray]:
    """Well conditioned data: white drives through a damped two-channel ARX system of order 2, and white noise."""
    rng = np.random.default_rng(seed)
    u = rng.normal(size=(samples, 2))
    a = np.array([[[-0.6, 0.2], [0.1, 0.3]], [[0.4, -0.1], [0.2, 0.3]]])
    b = rng.normal(size=(2, 2, 2))
    y = np.zeros((samples, 2))
    for t in range(2, samples):
        y[t] = sum(b[k] @ u[t - 1 - k] - a[k] @ y[t - 1 - k] for k in range(2)) + 0.1 * rng.normal(size=2)
    return y, u


@pytest.mark.parametrize("order", [1, 3, 10])
def test_gram_by_shifts_is_the_product_of_the_lagged_data(order: int) -> None:
    y, u = random_system()
    w = np.hstack([y, u])
    lagged = np.hstack([w[order - k : len(w) - k] for k in range(order + 1)])
    expected = lagged.T @ lagged
    np.testing.assert_allclose(gram_matrix(np.ascontiguousarray(w.T), order), expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize("order", [2, 8, 20])
def test_fast_fit_equals_lstsq_where_the_problem_is_well_conditioned(order: int) -> None:
    y, u = random_system()
    fast, oracle = fit_arx(y, u, order), fit_arx_lstsq(y, u, order)
    np.testing.assert_allclose(fast.A, oracle.A, rtol=0, atol=1e-8)
    np.testing.assert_allclose(fast.B, oracle.B, rtol=0, atol=1e-8)


def test_innovation_covariance_is_that_of_the_residuals() -> None:
    y, u = random_system()
    fast = fit_arx(y, u, 4)
    theta = np.concatenate([-fast.A, fast.B[1:]], axis=2).transpose(0, 2, 1).reshape(-1, 2)
    residual = y[4:] - regressors(np.hstack([y, u]), 4) @ theta
    expected = residual.T @ residual / (len(residual) - len(theta))
    np.testing.assert_allclose(fast.innovation_covariance, expected, rtol=1e-7, atol=1e-11)
    np.testing.assert_allclose(np.diag(fast.innovation_covariance), 0.01, rtol=0.1)


def test_direct_feedthrough_is_found_when_asked_for() -> None:
    rng = np.random.default_rng(2)
    u = rng.normal(size=(500, 1))
    y = 0.3 * u + np.vstack([[[0.0]], 0.7 * u[:-1]]) + 1e-6 * rng.normal(size=u.shape)
    model = fit_arx(y, u, 3, direct=True)
    assert abs(model.B[0, 0, 0] - 0.3) < 1e-6
    assert np.all(fit_arx(y, u, 3).B[0] == 0.0)


def test_fast_fit_equals_lstsq_of_the_same_ridge_on_bandpassed_data(at_60_db: Record) -> None:
    """Squaring a matrix of condition 1e17 costs nothing that the ridge has not given up already."""
    y, u = prefiltered(at_60_db)
    fast, oracle = route(fit_arx(y, u, 40)), route(fit_arx_lstsq(y, u, 40, ridge=1e-12))
    np.testing.assert_allclose(fast.axes.theta_deg, oracle.axes.theta_deg, rtol=0, atol=1e-4)
    np.testing.assert_allclose(fast.arx_split_hz, oracle.arx_split_hz, rtol=0, atol=1e-6)


def test_fast_fit_agrees_with_plain_lstsq_on_bandpassed_data(at_60_db: Record) -> None:
    y, u = prefiltered(at_60_db)
    fast, oracle = route(fit_arx(y, u, 40)), route(fit_arx_lstsq(y, u, 40))
    assert abs(fast.axes.mean_deg - oracle.axes.mean_deg) < 0.01
    assert abs(fast.arx_split_hz - oracle.arx_split_hz) < 1e-4


def test_units_and_order_of_the_channels_change_nothing_but_units_and_order(at_60_db: Record) -> None:
    y, u = prefiltered(at_60_db)
    plain = to_continuous(modes_of(fit_arx(y, u, 20), RATE), RATE)
    scaled = to_continuous(modes_of(fit_arx(y[:, ::-1] * [1e3, 1.0], u[:, ::-1] * [1.0, 1e-4], 20), RATE), RATE)
    np.testing.assert_allclose(scaled.poles, plain.poles, rtol=1e-8)
    back = scaled.residues[:, ::-1, ::-1] / np.array([1.0, 1e3])[:, None] * np.array([1e-4, 1.0])
    np.testing.assert_allclose(back, plain.residues, rtol=0, atol=1e-4 * np.abs(plain.residues).max())


def test_what_does_not_determine_a_model_is_refused() -> None:
    y, u = random_system(samples=300)
    with pytest.raises(IdentificationError, match="too short"):
        fit_arx(y, u, 70)
    with pytest.raises(IdentificationError, match="does not determine"):
        fit_arx(y, u * [1.0, 0.0], 4)
    broken = y.copy()
    broken[7, 1] = np.nan
    with pytest.raises(IdentificationError, match="not finite"):
        fit_arx(broken, u, 4)
