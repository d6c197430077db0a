"""Rate noise by the noise of the pick-offs."""

from __future__ import annotations

import numpy as np

from ...arrays import FloatArray
from ..figure import Figure
from ..open_loop import DEG_PER_RTH, OpenLoop


def value(gyro: OpenLoop) -> FloatArray:
    """sqrt(2) e / (V_s per rad/s) [deg/sqrt(h)]."""
    return np.asarray(DEG_PER_RTH * gyro.electronic_rad_per_rts)


FIGURE = Figure(
    name="arw_electronic_deg_per_rth",
    unit="deg/sqrt(h)",
    meaning="angle random walk by the noise of the pick-offs, in open loop",
    label="electronic angle random walk",
    formula="N = sqrt(2) e / K,  K the scale factor in V/(rad/s), e of one pick-off in V/sqrt(Hz), one-sided",
    source="white noise of two pick-offs through the scale factor; IEEE Std 1431 for N",
    needs=("angular_gain", "drive_amplitude_v", "pickoff_noise_v"),
    value=value,
)
