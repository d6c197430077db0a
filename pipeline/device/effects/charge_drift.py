"""Linear drift of the effective bias during a record, from charge that collects in dielectrics."""

from __future__ import annotations

from ...arrays import FloatArray
from ..effect import Context, Effect, Laws, LookAlike, SizeRange
from ..parameters import Parameter


def force(t: float, q: FloatArray, qd: FloatArray, u: FloatArray, p: FloatArray, laws: Laws, out: FloatArray) -> None:
    """Add gamma t F u + 2 kappa gamma t K q [V/s] to ``out`` (n,); t [s], u (D,) [V], q (n,) [V s], p = (gamma, kappa)."""
    change = p[0] * t
    for i in range(q.size):
        for k in range(u.size):
            out[i] += change * laws.drive[i, k] * u[k]
        for j in range(q.size):
            out[i] += 2.0 * p[1] * change * laws.stiffness[i, j] * q[j]


def sense(x: FloatArray, xd: FloatArray, s: FloatArray, t: FloatArray, p: FloatArray, context: Context) -> FloatArray:
    """s (1 + gamma t) (M, S) [V] at times t (M,) [s]; p[0] = gamma."""
    return s * (1.0 + p[0] * t[:, None])


EFFECT = Effect(
    name="charge_drift",
    law="V_b (1 + gamma t): F (1 + gamma t), S (1 + gamma t), K (1 - 2 kappa gamma t), kappa: electrostatic share of K",
    latex=r"V_b \to V_b\,(1 + \gamma t): \quad F \to F\,(1 + \gamma t), \quad S \to S\,(1 + \gamma t),"
    r" \quad K \to K\,(1 - 2\kappa\gamma t)",
    source="Liu et al., J. Semicond. 39 (2018) 084002: charge in dielectrics adds a voltage to the bias of a gyroscope",
    signature="drive and sense gains drift together, with a detuning of fixed proportion; reverses with the sweep direction",
    parameters=(
        Parameter("gamma", "1/s", -0.3, 1.0, "relative drift rate of the bias", scale=1e-3, relative_to="record"),
        # Without softening it equals a gain drift, because an exponential drift of the drive only shifts the damping.
        Parameter("kappa", "1", 5e-4, 0.01, "electrostatic part of the stiffness", 3e-3, 3e-3, grid=(5e-4, 2e-3, 8e-3)),
    ),
    force=force,
    sense=sense,
    plants=("gyro",),
    look_alikes=(LookAlike(("gain_drift", "frequency_drift"), {"gamma": 1e-4, "kappa": 3e-3}, always=True),),
    size=SizeRange(2e-4, 0.1),
)
