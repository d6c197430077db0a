"""Plant "gyro": the three parametrisations agree, and the numbers of the paper are reproduced."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.device.gyro import (
    cartesian_modes,
    gyro_mechanics,
    gyro_modes,
    rocking_hz,
    split_hz,
    to_cartesian,
    to_physical,
)
from pipeline.device.operation.bias import rate_biases_dps

PAPER = np.array([534.5, 536.4, 590.3, 3.167e-4, 1.586e-4, 11.7e-4, -33.2, 0.0, 13.33, 28.6, 0.0386, 0.0007])


def closed_form(x):
    poles, residues = np.empty(3, complex), np.empty((3, 2, 2), complex)
    cartesian_modes(x, poles, residues)
    return poles, residues


@given(
    split=st.floats(1e-4, 30.0),
    theta=st.floats(-89.999, 90.0),
    share=st.floats(-0.99, 0.99),
    zeta=st.tuples(st.floats(1e-5, 5e-3), st.floats(1e-5, 5e-3)),
)
def test_physical_and_cartesian_parameters_are_the_same_device(split, theta, share, zeta):
    physical = PAPER.copy()
    physical[1], physical[6] = physical[0] + split, theta
    physical[3:5] = zeta
    physical[7] = share * 2.0 * np.sqrt(np.prod(2.0 * np.pi * physical[:2] * physical[3:5]))
    back = to_physical(to_cartesian(physical[None]))[0]
    np.testing.assert_allclose(back[:6], physical[:6], rtol=1e-9)
    np.testing.assert_allclose(rocking_hz(to_cartesian(physical)), physical[:2], rtol=1e-12)
    # theta is as sharp as the split lets it be in double precision.
    assert abs((back[6] - theta + 90.0) % 180.0 - 90.0) < 1e-8 / split
    np.testing.assert_allclose(split_hz(to_cartesian(physical[None]))[0], split, rtol=1e-7, atol=1e-10)


def test_theta_is_the_lower_frequency_axis():
    mechanics = gyro_mechanics(PAPER[None])
    values, vectors = np.linalg.eigh(mechanics.stiffness[0, :2, :2])
    lower = np.rad2deg(np.arctan2(vectors[1, 0], vectors[0, 0]))
    assert abs((lower - PAPER[6] + 90.0) % 180.0 - 90.0) < 1e-6
    np.testing.assert_allclose(np.sqrt(values) / 2.0 / np.pi, PAPER[:2], rtol=1e-10)


def test_damping_in_the_stiffness_axes_is_c11_c22_c12():
    physical = PAPER.copy()
    physical[7] = 0.7
    axis = np.deg2rad(physical[6])
    u = np.array([[np.cos(axis), np.sin(axis)], [-np.sin(axis), np.cos(axis)]])
    rotated = u @ gyro_mechanics(physical[None]).damping[0, :2, :2] @ u.T
    c11, c22 = 4.0 * np.pi * physical[3] * physical[0], 4.0 * np.pi * physical[4] * physical[1]
    np.testing.assert_allclose(rotated, [[c11, 0.7], [0.7, c22]], rtol=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_closed_form_response_is_the_mechanics_response_even_where_modes_coalesce(seed):
    random = np.random.default_rng(seed)
    s = 2j * np.pi * np.linspace(532.0, 538.0, 31)
    for _ in range(40):
        c, c12 = random.uniform(1.0, 4.0), random.uniform(0.1, 0.9)
        gap = c12 * c / 2.0 * (1.0 + random.normal() * 10.0 ** random.uniform(-9.0, 0.0))
        omega1 = 2.0 * np.pi * 534.5
        physical = PAPER.copy()
        physical[:2] = omega1 / 2.0 / np.pi, (omega1 + abs(gap)) / 2.0 / np.pi
        physical[3:5] = c / 2.0 / (2.0 * np.pi * physical[:2])
        physical[7] = c12 * c / 2.0
        poles, residues = closed_form(to_cartesian(physical[None])[0])
        m = gyro_mechanics(physical[None])
        direct = np.array(
            [
                (m.velocity_sense[0] * si)
                @ np.linalg.solve(si**2 * np.eye(3) + si * m.damping[0] + m.stiffness[0], m.drive[0])
                for si in s
            ]
        )
        p, r = poles[None, :, None, None], residues[None]
        z = s[:, None, None, None]
        modal = np.sum(r / (z - p) + np.conj(r) / (z - np.conj(p)), axis=1)
        assert np.max(np.abs(modal - direct)) < 1e-7 * np.max(np.abs(direct))


def test_closed_form_modes_are_the_eigenvector_modes():
    physical = PAPER.copy()
    physical[7] = 0.4
    modes = gyro_modes(physical[None])
    poles, residues = closed_form(to_cartesian(physical[None])[0])
    np.testing.assert_allclose(poles, modes.poles[0], rtol=1e-13)
    np.testing.assert_allclose(residues, modes.residues[0], atol=1e-11 * np.abs(residues).max())


def test_rate_biases_of_the_paper_are_448_and_20_deg_per_second():
    physical = PAPER.copy()
    physical[6] = -33.23  # mean of the four printed thetas
    bias = rate_biases_dps(physical[None], 0.7, 1.0, "f1")
    np.testing.assert_allclose(bias["quadrature_rate_dps"], 448.0, atol=1.0)
    np.testing.assert_allclose(bias["quadrature_bias_dps"], 7.8, atol=0.05)
    np.testing.assert_allclose(bias["inphase_bias_dps"], 20.0, atol=0.3)


def test_rate_biases_are_the_same_for_theta_and_theta_plus_180_deg():
    opposite = PAPER.copy()
    opposite[6] += 180.0
    expected, found = (rate_biases_dps(p[None], 0.7, 1.0, "f2") for p in (PAPER, opposite))
    for name in expected:
        np.testing.assert_allclose(expected[name], found[name], rtol=1e-12)
