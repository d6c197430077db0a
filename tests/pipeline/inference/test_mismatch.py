"""Electrode mismatch and up-down tilt in the nightly model."""

from __future__ import annotations

import numpy as np

from pipeline.device.effect import Context, find_effects
from pipeline.device.gyro import cartesian_modes, gyro_mechanics, to_cartesian
from pipeline.device.mechanics import modes_of
from pipeline.inference.screening.mismatch import MismatchPrior, prior_from, with_mismatch, without_tilt

TILT, M_D, M_S = 0.011, -0.004, 0.007


def _modes(x):
    poles, residues = np.empty(3, dtype=np.complex128), np.empty((3, 2, 2), dtype=np.complex128)
    cartesian_modes(x, poles, residues)
    return poles, residues


def _effect_modes(physical, **sizes):
    mechanics = gyro_mechanics(physical[None])
    plant = {"sense_imbalance": physical[10], "drive_imbalance": physical[11]}
    for name, p in sizes.items():
        mechanics = find_effects()[name].mechanics(mechanics, np.array(p), Context(5.0, 5.0, plant))
    return modes_of(mechanics).residues[0]


def test_the_fourteen_parameters_are_the_effect_electrode_mismatch(paper_device):
    x = np.concatenate([to_cartesian(paper_device[None])[0], [M_D, M_S]])
    expected = _effect_modes(paper_device, electrode_mismatch=[M_D, M_S])
    np.testing.assert_allclose(_modes(x)[1], expected, rtol=1e-9)


def test_a_tilt_is_a_mismatch_with_other_imbalances_and_up_down_gain(paper_device):
    """The draws of the fit describe the tilted device exactly; ``without_tilt`` gives back its own imbalances and gain."""
    x = to_cartesian(paper_device[None])[0]
    s, d = x[10], x[11]
    tilted = np.concatenate([x, [0.0, 0.0]])
    tilted[10], tilted[11] = (s - TILT) / (1.0 - s * TILT), (d - TILT) / (1.0 - d * TILT)
    tilted[9] += np.log((1.0 - s * TILT) * (1.0 - d * TILT))
    tilted[12:] = d - tilted[11], s - tilted[10]
    np.testing.assert_allclose(_modes(tilted)[1], _effect_modes(paper_device, updown_tilt=[TILT]), rtol=1e-9)
    known = MismatchPrior(tilt=TILT)
    back = without_tilt(tilted[None], known, np.random.default_rng(0))[0]
    np.testing.assert_allclose(back, x, rtol=1e-12)


def test_the_prior_of_a_population_gives_the_tilt_as_far_as_the_mismatches_show_it():
    random = np.random.default_rng(1)
    mismatch, tilt = 1e-3 * random.standard_normal((20_000, 2)), 5e-3 * random.standard_normal(20_000)
    prior = prior_from(mismatch, tilt)
    # Two sums, each tilt + N(0, 1e-3): var(tilt | sums) = 1 / (1/25 + 2/1) in units of 1e-6.
    np.testing.assert_allclose(prior.tilt_sd, 1e-3 / np.sqrt(1.0 / 25.0 + 2.0), rtol=0.03)
    np.testing.assert_allclose(prior.covariance, 1e-6 * np.array([[26.0, 25.0], [25.0, 26.0]]), rtol=0.05)
    root, offset = prior.rows()
    np.testing.assert_allclose(root.T @ root @ np.array(prior.covariance), np.eye(2), atol=1e-4)
    np.testing.assert_allclose(root @ np.array(prior.mean), offset)


def test_a_start_without_mismatches_begins_at_the_mean_of_the_prior():
    prior = MismatchPrior((1e-3, 2e-3))
    start = np.arange(12.0)
    np.testing.assert_array_equal(with_mismatch(start, prior)[12:], [1e-3, 2e-3])
    assert with_mismatch(with_mismatch(start, prior), MismatchPrior())[12] == 1e-3
