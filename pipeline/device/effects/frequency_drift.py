"""Stiffness that drifts during a record."""

from __future__ import annotations

from ...arrays import FloatArray
from ..effect import Effect, Laws
from ..parameters import Parameter


def force(t: float, q: FloatArray, qd: FloatArray, u: FloatArray, p: FloatArray, laws: Laws, out: FloatArray) -> None:
    for i in range(q.size):
        for j in range(q.size):
            out[i] -= p[0] * t * laws.stiffness[i, j] * q[j]


EFFECT = Effect(
    name="frequency_drift",
    law="K (1 + beta t), t from the start of the record, all modes",
    source="temperature coefficient of Young's modulus of silicon: Hopcroft et al., JMEMS 19 (2010) 229",
    signature="detuning late in a record; flips with the direction of the sweep",
    parameters=(Parameter("beta", "1/s", -0.1, 0.1, "relative drift of all stiffness", scale=1e-4),),
    force=force,
)
