"""Saturation of the drive amplifier."""

from __future__ import annotations

import numpy as np

from ...arrays import FloatArray
from ..effect import Context, Effect
from ..parameters import Parameter


def drive(v: FloatArray, p: FloatArray, context: Context) -> FloatArray:
    """Clip v (N, D) [V] at +-1/p[0] [V]."""
    return np.clip(v, -1.0 / p[0], 1.0 / p[0])


EFFECT = Effect(
    name="drive_saturation",
    law="v is clipped at +-level, the same level for all drives",
    latex=r"v \to \max(-L, \min(L, v)), \quad L\ \text{the same for all drives}",
    source="limited output swing of an amplifier: Khalil, Nonlinear Systems (2002), example 7.4 (saturation)",
    signature="response grows less than the drive above a level, below it not at all; odd harmonics of the drive",
    parameters=(
        Parameter(
            "1/level",
            "1/V",
            0.0,
            1e3,
            "inverse of the clip level",
            scale=0.1,
            grid=tuple(0.1 * 1.15**k for k in range(34)),
            relative_to="drive",
        ),
    ),
    drive=drive,
)
