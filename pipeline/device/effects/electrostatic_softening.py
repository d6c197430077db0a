"""The pull of the drive electrodes grows as their gap closes."""

from __future__ import annotations

from ...arrays import FloatArray
from ..effect import Effect, Laws
from ..parameters import Parameter


def force(t: float, q: FloatArray, qd: FloatArray, u: FloatArray, p: FloatArray, laws: Laws, out: FloatArray) -> None:
    for k in range(u.size):
        x = 0.0
        for j in range(q.size):
            x += laws.motion[k, j] * q[j]
        y = p[0] * x
        # {(V/2 + u)/(1 - y)^2 - V/2 - V0 y} - u, with 1/(1 - y)^2 - 1 = y (2 - y)/(1 - y)^2 free of cancellation.
        pull = (0.5 * laws.bias_v + u[k]) * y * (2.0 - y) / ((1.0 - y) * (1.0 - y)) - laws.operating_bias_v * y
        for i in range(q.size):
            out[i] += laws.drive[i, k] * pull


EFFECT = Effect(
    name="electrostatic_softening",
    law="electrode k pulls with K_Dk {(V_b/2 + u_k)/(1 - x_k/g)^2 - V_b/2 - V_b x_k/g},  x = M_D^T psi + z",
    source="parallel plate, force (V_b + v)^2 / (g - x)^2: Senturia, Microsystem Design (2001), section 6.4",
    signature="as a softening cubic with even harmonics; drive and motion multiply; grows as bias^2",
    parameters=(Parameter("1/g", "1/(V s)", -2000.0, 2000.0, "inverse gap of the drive electrodes", scale=10.0),),
    force=force,
    plants=("gyro",),
)
