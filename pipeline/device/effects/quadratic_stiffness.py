"""Springs that differ between push and pull."""

from __future__ import annotations

from ...arrays import FloatArray
from ..effect import Effect, Laws
from ..parameters import Parameter


def force(t: float, q: FloatArray, qd: FloatArray, u: FloatArray, p: FloatArray, laws: Laws, out: FloatArray) -> None:
    for i in range(laws.axes):
        out[i] -= p[i] * q[i] * q[i]


EFFECT = Effect(
    name="quadratic_stiffness",
    law="psi_x'' -= k2x psi_x^2,  psi_y'' -= k2y psi_y^2",
    source="expansion of an asymmetric potential to third order: Nayfeh & Mook (1979), section 4.1",
    signature="offset and second harmonic that follow the square of the motion; softening in the second order",
    parameters=(Parameter("k2", "1/(V s^3)", -1e13, 1e13, "quadratic stiffness of an axis", scale=1e8, per="axis"),),
    force=force,
    plants=("gyro", "resonator"),
)
