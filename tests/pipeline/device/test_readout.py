"""Linear read-out: poles of amplifiers in series."""

from __future__ import annotations

import numpy as np

from pipeline.device.readout import plain_readout


def test_two_amplifiers_with_equal_poles_are_a_double_pole() -> None:
    s = 2j * np.pi * np.array([10.0, 530.0, 2500.0, 1e5])
    none = np.zeros(0, dtype=np.complex128)
    time_s = 5e-6
    readout = plain_readout(none, none, 2, 2).with_pole(-1.0 / time_s).with_pole(-1.0 / time_s, 0)
    single = 1.0 / (1.0 + s * time_s)
    expected = np.stack([single**2, single], axis=1)[:, :, None] * np.eye(2)
    np.testing.assert_allclose(readout.response(s), expected, atol=2e-7)
