"""The gain of the pick-offs drifts during a record."""

from __future__ import annotations

from ...arrays import FloatArray
from ..effect import Context, Effect
from ..parameters import Parameter


def sense(x: FloatArray, xd: FloatArray, s: FloatArray, t: FloatArray, p: FloatArray, context: Context) -> FloatArray:
    return s * (1.0 + p[0] * t[:, None])


EFFECT = Effect(
    name="gain_drift",
    law="S (1 + gamma t), t from the start of the record, both channels",
    source="warming of amplifier and bias reference",
    signature="amplitudes late in a record differ from those early; flips with the direction of the sweep; no detuning",
    parameters=(Parameter("gamma", "1/s", -0.3, 1.0, "relative drift of the gain", scale=1e-3),),
    sense=sense,
)
