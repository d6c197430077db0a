"""Damping that drifts during a record."""

from __future__ import annotations

from ...arrays import FloatArray
from ..effect import Effect, Laws
from ..parameters import Parameter


def force(t: float, q: FloatArray, qd: FloatArray, u: FloatArray, p: FloatArray, laws: Laws, out: FloatArray) -> None:
    for i in range(q.size):
        for j in range(q.size):
            out[i] -= p[0] * t * laws.damping[i, j] * qd[j]


EFFECT = Effect(
    name="damping_drift",
    law="C (1 + gamma t), t from the start of the record, all modes",
    source="free molecular gas damping is proportional to pressure, so C follows a leak or outgassing",
    signature="peaks passed late are broader than those passed early; flips with the sweep direction",
    parameters=(Parameter("gamma", "1/s", -0.3, 10.0, "relative drift of all damping", scale=0.05),),
    force=force,
)
