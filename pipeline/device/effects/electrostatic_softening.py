"""Electrostatic softening: the drive force grows as the gap closes."""

from __future__ import annotations

from ...arrays import FloatArray
from ..effect import Effect, Laws, SizeRange
from ..parameters import Parameter


def force(t: float, q: FloatArray, qd: FloatArray, u: FloatArray, p: FloatArray, laws: Laws, out: FloatArray) -> None:
    """Add F (force of each electrode - u) [V/s] to ``out`` (n,); q (n,) [V s], u (D,) [V], p[0] = 1/g [1/(V s)]."""
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
    law="force of electrode k: K_Dk {(V_b/2 + u_k)/(1 - x_k/g)^2 - V_b/2 - V_b x_k/g},  x = M_D^T psi + z",
    latex=r"\frac{F_k}{K_{Dk}} = \frac{V_b/2 + u_k}{(1 - x_k/g)^2} - \frac{V_b}{2} - \frac{V_b\,x_k}{g},"
    r" \quad x = M_D^T \psi + z",
    source="parallel plate, force (V_b + v)^2 / (g - x)^2: Senturia, Microsystem Design (2001), section 6.4",
    signature="like a softening cubic stiffness, with even harmonics and products of drive and motion; ~ bias squared",
    parameters=(Parameter("1/g", "1/(V s)", -2000.0, 2000.0, "inverse of the drive gap", scale=10.0),),
    force=force,
    plants=("gyro",),
    depends_on_bias=True,
    size=SizeRange(50.0, 500.0, signed=False),
)
