"""Square-law nonlinearity of the electrostatic drive force."""

from __future__ import annotations

from ...arrays import FloatArray
from ..effect import Context, Effect, SizeRange
from ..parameters import Parameter


def drive(v: FloatArray, p: FloatArray, context: Context) -> FloatArray:
    """v + eps v^2 / (2 V_b) (N, D) [V] from v (N, D) [V]; p[0] = eps [1]."""
    return v + p[0] * v**2 / (2.0 * context.bias_v)


EFFECT = Effect(
    name="drive_nonlinearity",
    law="force proportional to u = v + eps v^2 / (2 V_b);  eps = 1 for the ideal square law",
    latex=r"\text{force} \propto u = v + \varepsilon\,\frac{v^2}{2 V_b}",
    source="(V_b + v)^2 = V_b^2 + 2 V_b (v + v^2 / (2 V_b)): Senturia, Microsystem Design (2001), section 6.4",
    signature="response at zero and twice the drive frequency and at sums of the drive frequencies, ~ level squared",
    parameters=(Parameter("eps", "1", -2.0, 2.0, "fraction of the ideal square law", scale=0.1),),
    drive=drive,
    plants=("gyro",),
    depends_on_bias=True,
    size=SizeRange(0.3, 2.0, signed=False),
)
