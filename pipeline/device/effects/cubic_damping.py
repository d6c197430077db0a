"""Cubic damping."""

from __future__ import annotations

from ...arrays import FloatArray
from ..effect import Effect, Laws, SizeRange
from ..parameters import Parameter


def force(t: float, q: FloatArray, qd: FloatArray, u: FloatArray, p: FloatArray, laws: Laws, out: FloatArray) -> None:
    """Add -d |psi'|^2 psi' [V/s] to ``out`` (n,); qd (n,) [V], p[0] = d [1/(V^2 s)]."""
    square = 0.0
    for i in range(laws.axes):
        square += qd[i] * qd[i]
    for i in range(laws.axes):
        out[i] -= p[0] * square * qd[i]


EFFECT = Effect(
    name="cubic_damping",
    law="psi'' -= d |psi'|^2 psi',  d >= 0",
    latex=r"\psi'' = \cdots - d\,|\psi'|^2\,\psi', \quad d \ge 0",
    source="Zaitsev, Shtempluck, Buks & Gottlieb, Nonlinear Dynamics 67 (2012) 859; Nayfeh & Mook (1979), section 3.3",
    signature="resonance peaks grow less than the level, by the square of the motion; no frequency shift",
    parameters=(Parameter("d", "1/(V^2 s)", 0.0, 1e6, "damping per squared velocity", scale=0.1),),
    force=force,
    plants=("gyro", "resonator"),
    size=SizeRange(3e-3, 10.0, signed=False),
)
