"""Hankel singular values, balanced and modal truncation, and convergence with order and data."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from pipeline.experiment.instrument import AntiAlias, Instrument
from pipeline.experiment.record import Record
from pipeline.identification.arx import ArxModel, fit_arx
from pipeline.identification.bandpass import bandpass, window_slice
from pipeline.identification.failure import IdentificationError
from pipeline.identification.hankel import balance, frequency_response, modes_of_states, state_space_of, truncate
from pipeline.identification.lattice import fit_arx_lattice
from pipeline.identification.modes import modes_of
from pipeline.identification.reduction import order_study, reduce_model
from pipeline.identification.route import identify_record

RATE = 10_000.0
INSTRUMENT = Instrument(sample_rate_hz=RATE, antialias=AntiAlias())


@pytest.fixture(scope="module")
def order_40(at_60_db: Record) -> ArxModel:
    both = bandpass(np.hstack([at_60_db.sense_v, at_60_db.drive_v]), RATE)
    window = both[window_slice(both[:, :2], RATE)]
    return fit_arx(window[:, :2], window[:, 2:], 40)


def small_model(direct: float = 0.0) -> ArxModel:
    rng = np.random.default_rng(8)
    b = rng.normal(size=(4, 2, 2))
    b[0] *= direct
    return ArxModel(0.25 * rng.normal(size=(3, 2, 2)), b, np.eye(2))


@pytest.mark.parametrize("direct", [0.0, 1.0])
def test_state_space_and_polynomials_are_one_transfer_function(direct: float) -> None:
    model, grid = small_model(direct), np.linspace(1.0, 4999.0, 37)
    system = state_space_of(model)
    expected = frequency_response(model, grid, RATE)
    np.testing.assert_allclose(frequency_response(system, grid, RATE), expected, rtol=0, atol=1e-12)
    balanced = balance(system).system
    np.testing.assert_allclose(frequency_response(balanced, grid, RATE), expected, rtol=0, atol=1e-10)


def test_hankel_values_are_those_of_the_hankel_matrix_of_the_impulse_response() -> None:
    """The definition: singular values of the map from past drive to future sense, here 150 samples each."""
    system, length = state_space_of(small_model()), 150
    markov = [system.b]
    for _ in range(2 * length):
        markov.append(system.a @ markov[-1])
    hankel = np.block([[system.c @ markov[i + j] for j in range(length)] for i in range(length)])
    expected = np.linalg.svd(hankel, compute_uv=False)[:6]
    np.testing.assert_allclose(balance(system).hankel[:6], expected, rtol=1e-8)


def test_truncation_error_keeps_to_its_bound() -> None:
    model, grid = small_model(), np.linspace(0.0, 5000.0, 400)
    balanced = balance(state_space_of(model))
    full = frequency_response(model, grid, RATE)
    for states in (1, 2, 4, 5):
        reduced = frequency_response(truncate(balanced, states), grid, RATE)
        error = np.linalg.norm(full - reduced, ord=2, axis=(1, 2)).max()
        assert error <= 2.0 * balanced.hankel[states:].sum() * (1.0 + 1e-9)


def test_three_pairs_of_hankel_values_stand_out(order_40: ArxModel) -> None:
    """11.9, 6.4, 3.3 in pairs, as peak / 2 of light modes; the print's 15.2, 6.75, 3.49 contradict its own M, zeta."""
    reduction = reduce_model(order_40, INSTRUMENT)
    np.testing.assert_allclose(reduction.hankel[:6], [11.87, 11.87, 6.39, 6.39, 3.28, 3.28], rtol=5e-3)
    assert reduction.hankel[6] < 0.02 * reduction.hankel[5]
    assert 0.0 < reduction.error_bound < 1.0


def test_balanced_truncation_moves_theta_a_little_and_modal_truncation_does_not(order_40: ArxModel) -> None:
    reduction = reduce_model(order_40, INSTRUMENT)
    off_balanced = np.abs(reduction.balanced.axes.theta_deg + 33.0)
    off_modal = np.abs(reduction.modal.axes.theta_deg + 33.0)
    assert 0.01 < off_balanced.max() < 0.1
    assert off_modal.max() < 0.03
    assert off_modal.mean() < off_balanced.mean()
    assert abs(reduction.theta_shift_deg) < 0.05
    np.testing.assert_allclose(reduction.balanced.f_hz, reduction.modal.f_hz, rtol=0, atol=2e-3)


def test_balanced_truncation_wants_the_ridge(at_60_db: Record, order_40: ArxModel) -> None:
    """Without a ridge strong modes appear at the band's edges and spoil the first six states, not the modal terms."""
    both = bandpass(np.hstack([at_60_db.sense_v, at_60_db.drive_v]), RATE)
    window = both[window_slice(both[:, :2], RATE)]
    loose = reduce_model(fit_arx_lattice(window[:, :2], window[:, 2:], 40, 1e-16), INSTRUMENT)
    tight = reduce_model(order_40, INSTRUMENT)
    assert loose.hankel[6] > 10.0 * tight.hankel[6]
    assert np.abs(loose.balanced.axes.theta_deg + 33.0).max() > 3.0 * np.abs(tight.balanced.axes.theta_deg + 33.0).max()
    assert np.abs(loose.modal.axes.theta_deg + 33.0).max() < 0.03


def test_modes_of_a_state_space_are_those_of_the_polynomials(order_40: ArxModel) -> None:
    found = modes_of_states(state_space_of(order_40))
    expected = modes_of(order_40, RATE)
    for pole, residue in zip(expected.poles, expected.residues):
        k = int(np.argmin(np.abs(found.poles - pole)))
        assert abs(found.poles[k] - pole) < 1e-11
        np.testing.assert_allclose(found.residues[k], residue, rtol=0, atol=1e-6 * np.abs(residue).max())


def test_phase_and_theta_settle_with_the_order_where_harmonics_and_hum_are_left(at_60_db: Record) -> None:
    """Section 4.1: what the bandpass leaves of them biases a short model; order 40 has room for it."""
    t = np.arange(30_000) / RATE
    hum = sum(0.05 / k * np.cos(2.0 * np.pi * 60.0 * k * t + k) for k in range(1, 12))
    sense = at_60_db.sense_v + 0.05 * at_60_db.sense_v**2 + np.column_stack([hum, hum])
    steps = order_study(dataclasses.replace(at_60_db, sense_v=sense), INSTRUMENT, (6, 10, 40, 80))
    theta = {(step.order, step.window_s): abs(step.result.axes.mean_deg + 33.0) for step in steps}
    phase = {(step.order, step.window_s): step.phase_change_deg.max() for step in steps}
    for window_s in (2.0, 3.0):
        assert theta[6, window_s] > 0.5
        assert theta[10, window_s] > 0.5
        assert theta[40, window_s] < 0.1
        assert theta[80, window_s] < 0.1
        assert phase[10, window_s] > phase[40, window_s]
        assert phase[80, window_s] < 1e-9


def test_three_seconds_are_no_better_than_two_and_a_clean_record_needs_no_order_40(at_60_db: Record) -> None:
    """ "Using longer data sets did not improve the identified parameter estimates." """
    steps = order_study(at_60_db, INSTRUMENT, (10, 20, 40))
    theta = np.array([step.result.axes.mean_deg + 33.0 for step in steps])
    assert np.abs(theta).max() < 0.02
    alone = identify_record(at_60_db, INSTRUMENT, order=20)
    np.testing.assert_allclose(steps[1].result.axes.theta_deg, alone.axes.theta_deg, rtol=0, atol=1e-12)


def test_an_unstable_model_has_no_balance() -> None:
    grows = ArxModel(np.array([[[-1.01]]]), np.array([[[0.0]], [[1.0]]]), np.eye(1))
    with pytest.raises(IdentificationError, match="unstable"):
        balance(state_space_of(grows))
    with pytest.raises(IdentificationError, match="truncated"):
        truncate(balance(state_space_of(small_model())), 7)
