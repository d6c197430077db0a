"""Squeeze-film damping: the film on both sides of the mass damps more as one gap closes."""

from __future__ import annotations

from ...arrays import FloatArray
from ..effect import Effect, Laws, SizeRange
from ..parameters import Parameter


def force(t: float, q: FloatArray, qd: FloatArray, u: FloatArray, p: FloatArray, laws: Laws, out: FloatArray) -> None:
    """Add -{(1 + 3 y)/(1 - y)^3 - 1} C psi' [V/s] to ``out`` (n,), y = |psi|^2/g^2; q [V s], qd [V], p[0] = 1/g^2."""
    y = 0.0
    for i in range(laws.axes):
        y += p[0] * q[i] * q[i]
    # (1 + 3 y)/(1 - y)^3 - 1 free of cancellation.
    more = y * (6.0 - 3.0 * y + y * y) / ((1.0 - y) * (1.0 - y) * (1.0 - y))
    for i in range(laws.axes):
        for j in range(laws.axes):
            out[i] -= more * laws.damping[i, j] * qd[j]


EFFECT = Effect(
    name="squeeze_film_damping",
    law="C {1/(1 - x)^3 + 1/(1 + x)^3}/2 instead of C,  x = |psi|/g",
    latex=r"C \to \frac{C}{2 (1 - x)^3} + \frac{C}{2 (1 + x)^3}, \quad x = |\psi|/g",
    source="damping ~ 1/gap^3 of an incompressible film: Bao & Yang, Sensors and Actuators A 136 (2007) 3",
    signature="as cubic damping, in proportion to the linear damping and to the motion instead of the velocity",
    parameters=(Parameter("1/g^2", "1/(V s)^2", 0.0, 4e6, "inverse square of the gap", scale=1e4),),
    force=force,
    plants=("gyro", "resonator"),
    size=SizeRange(3e3, 1e6, signed=False),
)
