"""Pull-in of the drive electrodes, in units of the bias."""

from __future__ import annotations

import numpy as np

from ...arrays import FloatArray
from ..figure import Figure
from ..open_loop import OpenLoop


def value(gyro: OpenLoop) -> FloatArray:
    """V_pi / V_b [1]."""
    return np.asarray(
        np.sqrt(4.0 * gyro.gap_at_rest**2 * gyro.gap_at_rest / (27.0 * gyro.compliance * gyro.bias_v * gyro.gap**2))
    )


FIGURE = Figure(
    name="pull_in_margin",
    unit="1",
    meaning="bias at which the drive electrodes pull in, over the bias of the test",
    label="pull-in margin",
    formula="V_pi^2 = 4 g0^3 V_b / (27 C g^2),  1/C = 1/C_b + 2 V_b/g, C_b = G_r (K^-1)_yy + G_z / omega3^2,  g0 = g + C V_b",
    source="parallel plate on a spring: Senturia, Microsystem Design (2001), section 6.4.3; up-down and rocking in series",
    needs=("softening_hz_per_v2", "bias_v"),
    value=value,
)
