"""Electrostatic force goes with the square of the voltage."""

from __future__ import annotations

from ...arrays import FloatArray
from ..effect import Context, Effect
from ..parameters import Parameter


def drive(v: FloatArray, p: FloatArray, context: Context) -> FloatArray:
    return v + p[0] * v**2 / (2.0 * context.bias_v)


EFFECT = Effect(
    name="drive_nonlinearity",
    law="force on u = v + eps v^2 / (2 V_b);  eps = 1 for the ideal square law",
    source="(V_b + v)^2 = V_b^2 + 2 V_b (v + v^2 / (2 V_b)): Senturia, Microsystem Design (2001), section 6.4",
    signature="response at twice the drive frequency and at offset; beats of the drives; grows as level squared",
    parameters=(Parameter("eps", "1", -2.0, 2.0, "share of the ideal square law", scale=0.1),),
    drive=drive,
    plants=("gyro",),
)
