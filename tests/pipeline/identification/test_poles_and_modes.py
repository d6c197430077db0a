"""Poles three ways, residues, and the inversion of each hold."""

from __future__ import annotations

from typing import get_args

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.device.mechanics import Modes
from pipeline.experiment.antialias import behind_filter
from pipeline.experiment.forward.modal_bank import respond
from pipeline.experiment.instrument import Hold
from pipeline.experiment.record import Record
from pipeline.identification.arx import ArxModel, fit_arx
from pipeline.identification.bandpass import bandpass, window_slice
from pipeline.identification.failure import IdentificationError
from pipeline.identification.modes import (
    ContinuousModes,
    DiscreteModes,
    band_poles,
    modes_from_fractions,
    modes_of,
    residues_at,
    to_continuous,
)
from pipeline.identification.poles import companion_poles, nearby_poles, refine

RATE = 10_000.0


def model_with_poles(z: np.ndarray, axes_deg: np.ndarray) -> ArxModel:
    """Order-2 blocks (I - 2 Re z q + |z|^2 q^2) along an axis each: A(z) has exactly the zeros z and conj z."""
    c, s = np.cos(np.deg2rad(axes_deg)), np.sin(np.deg2rad(axes_deg))
    turn = np.array([[c, -s], [s, c]])
    a1 = turn @ np.diag(-2.0 * z.real) @ turn.T
    a2 = turn @ np.diag(np.abs(z) ** 2) @ turn.T
    b = np.zeros((3, 2, 2))
    b[1] = np.eye(2)
    return ArxModel(np.stack([a1, a2]), b, np.eye(2))


@pytest.mark.parametrize("order", [10, 40, 80])
def test_arnoldi_and_newton_give_the_companion_eigenvalues_of_the_band(at_60_db: Record, order: int) -> None:
    both = bandpass(np.hstack([at_60_db.sense_v, at_60_db.drive_v]), RATE)
    window = both[window_slice(both[:, :2], RATE)]
    model = fit_arx(window[:, :2], window[:, 2:], order)
    found = band_poles(model, RATE, (400.0, 700.0))
    everything = companion_poles(model.A)
    frequency = np.angle(everything) * RATE / (2.0 * np.pi)
    reach = -3.0 * np.log(np.abs(everything)) * RATE / (2.0 * np.pi)
    inside = everything[(reach > 0.0) & (frequency - reach > 400.0) & (frequency + reach < 700.0)]
    assert inside.size >= 3
    for z in inside:
        assert np.abs(found - z).min() < 1e-10


@settings(max_examples=40, deadline=None)
@given(
    f=st.floats(450.0, 650.0),
    split=st.sampled_from([0.0, 1e-6, 0.02, 1.0, 30.0]),
    zeta=st.floats(1e-5, 5e-3),
    axis=st.floats(-90.0, 90.0),
)
def test_poles_and_residues_survive_any_split(f: float, split: float, zeta: float, axis: float) -> None:
    """Two modes along orthogonal axes stay two, however close; residues are projectors on the axes."""
    omega = 2.0 * np.pi * np.array([f, f + split])
    z = np.exp((-zeta + 1j * np.sqrt(1 - zeta**2)) * omega / RATE)
    model = model_with_poles(z, np.float64(axis))
    seeds = nearby_poles(model.A, complex(np.exp(0.35j)))
    poles, _ = refine(model.A, seeds[seeds.imag > 0])
    np.testing.assert_allclose(np.sort(poles.imag), np.sort(z.imag), rtol=0, atol=1e-13)
    if split >= 0.02:
        found = modes_of(model, RATE, count=2)
        np.testing.assert_allclose(found.poles, z, rtol=0, atol=1e-13)
        c, s = np.cos(np.deg2rad(axis)), np.sin(np.deg2rad(axis))
        lower = np.outer([c, s], [c, s]) * z[0] / (2j * z[0].imag)
        np.testing.assert_allclose(found.residues[0], lower, rtol=0, atol=1e-7 * np.abs(lower).max())


def test_residues_rebuild_the_transfer_function() -> None:
    rng = np.random.default_rng(4)
    a = rng.normal(size=(3, 2, 2)) * 0.2
    b = np.concatenate([np.zeros((1, 2, 3)), rng.normal(size=(3, 2, 3))])
    model = ArxModel(a, b, np.eye(2))
    poles, _ = refine(a, companion_poles(a))
    residues = residues_at(model, poles)
    s = np.exp(1j * np.array([0.1, 0.9, 2.5]))
    powers = s[:, None] ** -np.arange(4)
    direct = np.linalg.solve(np.eye(2) + np.tensordot(powers[:, 1:], a, axes=1), np.tensordot(powers, b, axes=1))
    summed = np.einsum("kab,fk->fab", residues, 1.0 / (s[:, None] - poles))
    np.testing.assert_allclose(summed, direct, rtol=1e-9, atol=1e-11)


@pytest.mark.parametrize("hold", get_args(Hold))
def test_inverting_the_hold_undoes_it(hold: Hold) -> None:
    """Poles and residues of a simulated device come back through its own hold."""
    rng = np.random.default_rng(5)
    p = 2.0 * np.pi * np.array([500.0, 520.0]) * (-2e-3 + 1j)
    left, right = rng.normal(size=(2, 2, 2, 2)) @ [1.0, 1j]
    residues = left[:, :, None] * right[:, None, :]
    bank = behind_filter(Modes(p[None], residues[None]), None)
    # In-band drive, so that the band-limited hold is the smooth function between its samples.
    drive = bandpass(rng.normal(size=(4000, 2)), RATE)
    sense = respond(bank, drive, RATE, hold)[0]
    model = fit_arx(sense, drive, 4 if hold != "bandlimited" else 12, ridge=1e-14, direct=hold != "zoh")
    found = to_continuous(modes_of(model, RATE, count=2), RATE, hold)
    np.testing.assert_allclose(found.poles, p, rtol=1e-6)
    tolerance = 1e-4 if hold != "bandlimited" else 2e-2
    np.testing.assert_allclose(found.residues, residues, rtol=0, atol=tolerance * np.abs(residues).max())


def test_fractions_and_residues_are_the_same_thing() -> None:
    rng = np.random.default_rng(6)
    modes = ContinuousModes(
        np.array([-1.0 + 3000.0j, -2.0 + 4000.0j]), rng.normal(size=(2, 2, 2)) + 1j * rng.normal(size=(2, 2, 2))
    )
    again = modes_from_fractions(modes.frequency_hz, modes.zeta, modes.R1, modes.R0)
    np.testing.assert_allclose(again.poles, modes.poles, rtol=1e-12)
    np.testing.assert_allclose(again.residues, modes.residues, rtol=1e-9)


def test_too_few_modes_in_the_band_is_said_so() -> None:
    model = model_with_poles(np.exp(np.array([0.3j, 0.31j]) - 1e-4), np.float64(10.0))
    with pytest.raises(IdentificationError, match="too few stable modes"):
        modes_of(model, RATE, count=3)


@pytest.mark.parametrize("shape", [(2, 2), (2, 3)])
def test_the_peak_is_the_largest_singular_value_over_the_distance_from_the_circle(shape):
    random = np.random.default_rng(9)
    residues = random.standard_normal((4, *shape)) + 1j * random.standard_normal((4, *shape))
    # A matrix of rank one, one that is nearly orthogonal, and none.
    residues[1] = np.outer(residues[0, :, 0], residues[0, 0])
    residues[2, :2, :2] = np.eye(2) + 1e-9j * residues[2, :2, :2]
    residues[3] = 0.0
    found = DiscreteModes(np.full(4, 0.9j), residues).peak
    np.testing.assert_allclose(found, np.linalg.svd(residues)[1][:, 0] / 0.1, rtol=1e-12)
