"""Linear drift of the damping during a record."""

from __future__ import annotations

from ...arrays import FloatArray
from ..effect import Effect, Laws, SizeRange
from ..parameters import Parameter


def force(t: float, q: FloatArray, qd: FloatArray, u: FloatArray, p: FloatArray, laws: Laws, out: FloatArray) -> None:
    """Add -gamma t C q' [V/s] to ``out`` (n,); t [s], qd (n,) [V], p[0] = gamma [1/s]."""
    for i in range(q.size):
        for j in range(q.size):
            out[i] -= p[0] * t * laws.damping[i, j] * qd[j]


EFFECT = Effect(
    name="damping_drift",
    law="C (1 + gamma t) for all modes, t from the start of the record",
    latex=r"C \to C\,(1 + \gamma t)",
    source="free-molecular gas damping is proportional to pressure, so C follows a leak or outgassing",
    signature="resonances that the sweep passes late are broader than those it passes early; reverses with the sweep direction",
    parameters=(
        Parameter("gamma", "1/s", -0.3, 10.0, "relative drift rate of the damping", scale=0.05, relative_to="record"),
    ),
    force=force,
    size=SizeRange(2e-3, 1.0, signed=False),
)
