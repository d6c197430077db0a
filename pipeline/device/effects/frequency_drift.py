"""Linear drift of the stiffness during a record."""

from __future__ import annotations

from ...arrays import FloatArray
from ..effect import Effect, Laws, SizeRange
from ..parameters import Parameter


def force(t: float, q: FloatArray, qd: FloatArray, u: FloatArray, p: FloatArray, laws: Laws, out: FloatArray) -> None:
    """Add -beta t K q [V/s] to ``out`` (n,); t [s], q (n,) [V s], p[0] = beta [1/s]."""
    for i in range(q.size):
        for j in range(q.size):
            out[i] -= p[0] * t * laws.stiffness[i, j] * q[j]


EFFECT = Effect(
    name="frequency_drift",
    law="K (1 + beta t) for all modes, t from the start of the record",
    latex=r"K \to K\,(1 + \beta t)",
    source="temperature coefficient of Young's modulus of silicon: Hopcroft et al., JMEMS 19 (2010) 229",
    signature="detuning that grows during a record; reverses with the sweep direction",
    parameters=(
        Parameter("beta", "1/s", -0.1, 0.1, "relative drift rate of the stiffness", scale=1e-4, relative_to="record"),
    ),
    force=force,
    size=SizeRange(1e-6, 1e-2),
)
