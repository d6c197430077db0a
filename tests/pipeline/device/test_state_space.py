"""The exported state-space matrices reproduce the device."""

import numpy as np

from pipeline.device.gyro import gyro_mechanics, gyro_modes
from pipeline.device.operation.state_space import state_space
from pipeline.experiment.antialias import behind_filter
from pipeline.experiment.forward.modal_bank import respond

DEVICE = np.array([[534.5, 536.4, 590.3, 3.167e-4, 1.586e-4, 11.7e-4, -33.2, 0.4, 13.33, 28.6, 0.0386, 0.0007]])


def test_discrete_model_simulates_the_same_volts_as_the_modes():
    ss = state_space(gyro_mechanics(DEVICE), 10_000.0)
    drive = np.random.default_rng(1).normal(size=(500, 2))
    x, volts = np.zeros(6), np.empty((500, 2))
    for n in range(500):
        volts[n] = ss.C @ x
        x = ss.Ad @ x + ss.Bd @ drive[n]
    expected = respond(behind_filter(gyro_modes(DEVICE), None), drive, 10_000.0, "zoh")[0]
    np.testing.assert_allclose(volts, expected, atol=1e-12 * np.abs(expected).max())


def test_continuous_model_has_the_transfer_function_of_the_modes():
    ss = state_space(gyro_mechanics(DEVICE), 10_000.0)
    s = 2j * np.pi * np.array([400.0, 535.0, 590.0, 2000.0])
    direct = np.stack([ss.C @ np.linalg.solve(si * np.eye(6) - ss.A, ss.B) for si in s], axis=-1)
    np.testing.assert_allclose(direct, gyro_modes(DEVICE).response(s)[0], rtol=1e-7)
