"""Rate noise by the Brownian motion of the free mode."""

from __future__ import annotations

import numpy as np

from ...arrays import FloatArray
from ..figure import Figure
from ..open_loop import DEG_PER_RTH, OpenLoop


def value(gyro: OpenLoop) -> FloatArray:
    """sqrt(k_B T c_s / m) / (kappa l psi_d') [deg/sqrt(h)]."""
    return np.asarray(DEG_PER_RTH * gyro.thermal_rad_per_rts)


FIGURE = Figure(
    name="arw_thermal_deg_per_rth",
    unit="deg/sqrt(h)",
    meaning="angle random walk by the Brownian motion of the free mode: the angle has the variance N^2 t",
    label="thermal angle random walk",
    formula="N = sqrt(k_B T c_s / m) / (kappa l psi_d'),  m = I_0p / l^2,  l psi_d' [m/s] from the drive amplitude and the gap",
    source="Leland, IEEE Sensors J. 5 (2005) 493: one half of the noise power is in phase; fluctuation-dissipation theorem",
    needs=("angular_gain", "drive_amplitude_v", "softening_hz_per_v2", "bias_v", "gap_um", "mass_mg", "temperature_c"),
    value=value,
)
