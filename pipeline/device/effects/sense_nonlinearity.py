"""Pick-off nonlinearity: the sensitivity grows as the gap closes."""

from __future__ import annotations

from ...arrays import FloatArray
from ..effect import Context, Effect, SizeRange
from ..parameters import Parameter


def sense(x: FloatArray, xd: FloatArray, s: FloatArray, t: FloatArray, p: FloatArray, context: Context) -> FloatArray:
    """s / (1 - x/g)^2 (M, S) [V] at motion x (M, S) [V s]; p[0] = 1/g [1/(V s)]."""
    return s / (1.0 - p[0] * x) ** 2


EFFECT = Effect(
    name="sense_nonlinearity",
    law="S = x' / (1 - x/g)^2",
    latex=r"S = \frac{x'}{(1 - x/g)^2}",
    source="current of a biased parallel plate, V_b dC/dt with C = eps A / (g - x): Senturia (2001), section 6.4",
    signature="second and third harmonics of the motion without a frequency shift; mostly outside 400 to 700 Hz",
    parameters=(Parameter("1/g", "1/(V s)", -2000.0, 2000.0, "inverse of the sense gap", scale=10.0),),
    sense=sense,
    plants=("gyro",),
    size=SizeRange(2.0, 500.0, signed=False),
)
