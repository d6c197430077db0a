"""The converter's input stage clips below full scale."""

from __future__ import annotations

import numpy as np

from ...arrays import FloatArray
from ..effect import Context, Effect
from ..parameters import Parameter


def adc(y: FloatArray, p: FloatArray, context: Context) -> FloatArray:
    return np.clip(y, -1.0 / p[0], 1.0 / p[0])


EFFECT = Effect(
    name="adc_saturation",
    law="y clipped at +- level, both channels, below full scale",
    source="supply rails of the input amplifier",
    signature="only at the peaks: flat tops, odd harmonics, nothing below the level",
    parameters=(
        Parameter(
            "1/level", "1/V", 0.0, 1e3, "inverse level", scale=0.1, grid=tuple(0.02 * 1.03**k for k in range(200))
        ),
    ),
    adc=adc,
)
