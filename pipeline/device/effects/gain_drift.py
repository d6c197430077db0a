"""Linear drift of the pick-off gain during a record."""

from __future__ import annotations

from ...arrays import FloatArray
from ..effect import Context, Effect, SizeRange
from ..parameters import Parameter


def sense(x: FloatArray, xd: FloatArray, s: FloatArray, t: FloatArray, p: FloatArray, context: Context) -> FloatArray:
    """s (1 + gamma t) (M, S) [V] at times t (M,) [s]; p[0] = gamma [1/s]."""
    return s * (1.0 + p[0] * t[:, None])


EFFECT = Effect(
    name="gain_drift",
    law="S (1 + gamma t) in both channels, t from the start of the record",
    latex=r"S \to S\,(1 + \gamma t)",
    source="thermal drift of the amplifier and of the bias reference",
    signature="amplitudes late in a record differ from those early in it; reverses with the sweep direction; no detuning",
    parameters=(
        Parameter("gamma", "1/s", -0.3, 1.0, "relative drift rate of the gain", scale=1e-3, relative_to="record"),
    ),
    sense=sense,
    size=SizeRange(5e-4, 0.2),
)
