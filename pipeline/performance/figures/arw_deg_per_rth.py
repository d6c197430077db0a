"""Rate noise, thermal and electronic together."""

from __future__ import annotations

import numpy as np

from ...arrays import FloatArray
from ..figure import Figure
from ..open_loop import DEG_PER_RTH, OpenLoop


def value(gyro: OpenLoop) -> FloatArray:
    """sqrt(thermal^2 + electronic^2) [deg/sqrt(h)]."""
    return np.asarray(DEG_PER_RTH * np.sqrt(gyro.thermal_rad_per_rts**2 + gyro.electronic_rad_per_rts**2))


FIGURE = Figure(
    name="arw_deg_per_rth",
    unit="deg/sqrt(h)",
    meaning="angle random walk, thermal and electronic together",
    label="angle random walk",
    formula="sqrt(arw_thermal_deg_per_rth^2 + arw_electronic_deg_per_rth^2)",
    source="independent noises add in power",
    needs=(
        "angular_gain",
        "drive_amplitude_v",
        "softening_hz_per_v2",
        "bias_v",
        "gap_um",
        "mass_mg",
        "temperature_c",
        "pickoff_noise_v",
    ),
    value=value,
)
