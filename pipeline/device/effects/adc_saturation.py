"""ADC input saturation below full scale."""

from __future__ import annotations

import numpy as np

from ...arrays import FloatArray
from ..effect import Context, Effect
from ..parameters import Parameter


def adc(y: FloatArray, p: FloatArray, context: Context) -> FloatArray:
    """Clip y (N, S) [V] at +-1/p[0] [V]."""
    return np.clip(y, -1.0 / p[0], 1.0 / p[0])


EFFECT = Effect(
    name="adc_saturation",
    law="y is clipped at +-level, the same level in both channels, below full scale",
    latex=r"y \to \max(-L, \min(L, y)), \quad L\ \text{the same in both channels}",
    source="supply limits of the input amplifier",
    signature="flat peaks and odd harmonics; samples below the level are unchanged",
    parameters=(
        Parameter(
            "1/level",
            "1/V",
            0.0,
            1e3,
            "inverse of the clip level",
            scale=0.1,
            grid=tuple(0.02 * 1.03**k for k in range(200)),
            relative_to="sense",
        ),
    ),
    adc=adc,
)
