"""How the scale factor depends on the split: what a drift of the modes against each other does to it."""

from __future__ import annotations

import numpy as np

from ...arrays import FloatArray
from ..figure import Figure
from ..open_loop import TAU, OpenLoop


def value(gyro: OpenLoop) -> FloatArray:
    """d ln(scale factor) / d split [1/Hz] at a constant driven mode: -2 pi |D| (2 omega_s / omega0) / (D^2 + c^2)."""
    d, c = np.abs(gyro.detuning), gyro.damping
    return np.asarray(-2.0 * TAU * gyro.omega_s / gyro.omega0 * d / (d**2 + c**2))


FIGURE = Figure(
    name="scale_factor_split_per_hz",
    unit="1/Hz",
    meaning="relative change of the open-loop scale factor per Hz of split; -1/split at high Q, 0 for equal modes",
    label="dependence of the scale factor on the split",
    formula="-2 pi |D| (2 omega_s / omega0) / (D^2 + c_s^2)",
    source="derivative of scale_factor_v_per_dps with respect to omega_s",
    needs=(),
    value=value,
)
