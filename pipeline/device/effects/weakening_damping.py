"""Damping that falls with speed."""

from __future__ import annotations

import numpy as np

from ...arrays import FloatArray
from ..effect import Effect, Laws, SizeRange
from ..parameters import Parameter


def force(t: float, q: FloatArray, qd: FloatArray, u: FloatArray, p: FloatArray, laws: Laws, out: FloatArray) -> None:
    """Add {1 - 1/(1 + |psi'|/s)} C psi' [V/s] to ``out`` (n,); qd (n,) [V], p[0] = 1/s [1/V]."""
    square = 0.0
    for i in range(laws.axes):
        square += qd[i] * qd[i]
    ratio = p[0] * np.sqrt(square)
    less = ratio / (1.0 + ratio)
    for i in range(laws.axes):
        for j in range(laws.axes):
            out[i] += less * laws.damping[i, j] * qd[j]


EFFECT = Effect(
    name="weakening_damping",
    law="C / (1 + |psi'|/s) instead of C",
    latex=r"C \to \frac{C}{1 + |\psi'|/s}",
    source="shear-thinning film: Cross, J. Colloid Science 20 (1965) 417, with exponent 1 and no viscosity at infinite rate",
    signature="resonance peaks grow more than the level; no frequency shift",
    parameters=(Parameter("1/s", "1/V", 0.0, 1e3, "inverse of the speed at which the damping is halved", scale=0.01),),
    force=force,
    plants=("gyro", "resonator"),
    size=SizeRange(2e-3, 10.0, signed=False),
)
