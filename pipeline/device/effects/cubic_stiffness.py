"""Springs that stiffen (or soften) with the square of the motion."""

from __future__ import annotations

from ...arrays import FloatArray
from ..effect import Effect, Laws
from ..parameters import Parameter


def force(t: float, q: FloatArray, qd: FloatArray, u: FloatArray, p: FloatArray, laws: Laws, out: FloatArray) -> None:
    square = 0.0
    for i in range(laws.axes):
        square += q[i] * q[i]
    for i in range(laws.axes):
        out[i] -= p[0] * square * q[i]


EFFECT = Effect(
    name="cubic_stiffness",
    law="psi'' -= k3 |psi|^2 psi,  potential k3 |psi|^4 / 4",
    source="Duffing; isotropic in psi by the fourfold symmetry of the suspension, Nayfeh & Mook (1979), section 4.1",
    signature="leaning peak, shift grows as the square of the level, up-sweep differs from down-sweep, third harmonic",
    parameters=(Parameter("k3", "1/(V^2 s^4)", -1e15, 1e15, "cubic stiffness, either sign", scale=1e9),),
    force=force,
    plants=("gyro", "resonator"),
)
