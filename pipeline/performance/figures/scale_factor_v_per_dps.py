"""Scale factor in open loop: the free mode answers the Coriolis force below or above its own resonance."""

from __future__ import annotations

import numpy as np

from ...arrays import FloatArray
from ..figure import Figure
from ..open_loop import OpenLoop


def value(gyro: OpenLoop) -> FloatArray:
    """2 kappa A (sense / drive blend) / sqrt(D^2 + c^2) [V/(deg/s)]."""
    return np.asarray(gyro.volts_per_rad_s * np.deg2rad(1.0))


FIGURE = Figure(
    name="scale_factor_v_per_dps",
    unit="V/(deg/s)",
    meaning="amplitude of the free mode's pick-off signal per constant rate in open loop, at the declared drive amplitude",
    label="open-loop scale factor",
    formula="2 kappa A (V_s/psi_s') / (V_d/psi_d') / sqrt(D^2 + c_s^2),  D = (omega_s^2 - omega0^2) / omega0",
    source="the paper, eq. (2), at a constant amplitude of the driven mode; Acar, Shkel: MEMS Vibratory Gyroscopes (2009), ch. 2",
    needs=("angular_gain", "drive_amplitude_v"),
    value=value,
)
