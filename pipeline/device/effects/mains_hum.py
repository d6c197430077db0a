"""Mains hum: harmonics of 50 or 60 Hz."""

from __future__ import annotations

import numpy as np

from ...arrays import FloatArray
from ..effect import Context, Effect
from ..parameters import Parameter


def disturbance(t: FloatArray, p: FloatArray, context: Context) -> FloatArray:
    """cos, then sin, of 2 pi h f t (N, 2 H) [1] for the H harmonics below f_s/2; t (N,) [s], p = (f [Hz], top [1])."""
    rate = (t.size - 1) / (t[-1] - t[0])
    harmonics = np.arange(1, 1 + min(int(p[1]), int(np.ceil(rate / 2.0 / p[0] - 1e-9)) - 1))
    angle = 2.0 * np.pi * p[0] * t[:, None] * harmonics
    return np.concatenate([np.cos(angle), np.sin(angle)], axis=1)


EFFECT = Effect(
    name="mains_hum",
    law="S += sum_h a_h cos(2 pi h f t) + b_h sin(2 pi h f t), h = 1 .. top; a_h, b_h free per channel and record",
    latex=r"S = \cdots + \sum_{h=1}^{\text{top}} a_h \cos(2\pi h f t) + b_h \sin(2\pi h f t)",
    source="the paper, section 3.1 and figure 4 (multiples of 60 Hz)",
    signature="lines at fixed frequencies, also in silent records",
    parameters=(
        Parameter(
            "f", "Hz", 50.0, 60.0, "mains frequency", 60.0, grid=(50.0, 60.0), fitted=False, relative_to="absolute"
        ),
        Parameter("top", "1", 1.0, 1e3, "number of the highest harmonic", 16.0, grid=(1.0, 5.0, 16.0), fitted=False),
    ),
    disturbance=disturbance,
    mains_frequency="f",
)
