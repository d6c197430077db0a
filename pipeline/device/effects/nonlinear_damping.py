"""Quadratic damping (drag)."""

from __future__ import annotations

import numpy as np

from ...arrays import FloatArray
from ..effect import Effect, Laws, SizeRange
from ..parameters import Parameter


def force(t: float, q: FloatArray, qd: FloatArray, u: FloatArray, p: FloatArray, laws: Laws, out: FloatArray) -> None:
    """Add -d |psi'| psi' [V/s] to ``out`` (n,); qd (n,) [V], p[0] = d [1/(V s)]."""
    square = 0.0
    for i in range(laws.axes):
        square += qd[i] * qd[i]
    rate = p[0] * np.sqrt(square)
    for i in range(laws.axes):
        out[i] -= rate * qd[i]


EFFECT = Effect(
    name="nonlinear_damping",
    law="psi'' -= d |psi'| psi',  d >= 0",
    latex=r"\psi'' = \cdots - d\,|\psi'|\,\psi', \quad d \ge 0",
    source="quadratic drag: Nayfeh & Mook, Nonlinear Oscillations (1979), section 3.3",
    signature="resonance peaks grow less than the level; no frequency shift",
    parameters=(Parameter("d", "1/(V s)", 0.0, 1e6, "drag coefficient", scale=0.1),),
    force=force,
    plants=("gyro", "resonator"),
    size=SizeRange(3e-3, 10.0, signed=False),
)
