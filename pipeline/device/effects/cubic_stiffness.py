"""Cubic (Duffing) stiffness."""

from __future__ import annotations

import numpy as np

from ...arrays import FloatArray
from ..effect import Effect, Laws, SizeRange
from ..parameters import Parameter


def force(t: float, q: FloatArray, qd: FloatArray, u: FloatArray, p: FloatArray, laws: Laws, out: FloatArray) -> None:
    """Add -k3 |psi|^2 psi [V/s] to ``out`` (n,); q (n,) [V s], p[0] = k3 [1/(V^2 s^4)]."""
    square = 0.0
    for i in range(laws.axes):
        square += q[i] * q[i]
    for i in range(laws.axes):
        out[i] -= p[0] * square * q[i]


def potential(q: FloatArray, p: FloatArray, axes: int) -> FloatArray:
    """k3 |psi|^4 / 4 (M,) [V^2] at q (M, n) [V s]."""
    return np.asarray(p[0] / 4.0 * np.sum(q[:, :axes] ** 2, axis=1) ** 2)


EFFECT = Effect(
    name="cubic_stiffness",
    law="psi'' -= k3 |psi|^2 psi,  potential k3 |psi|^4 / 4",
    latex=r"\psi'' = \cdots - k_3\,|\psi|^2\,\psi, \quad \text{potential}\ \frac{k_3}{4} |\psi|^4",
    source="Duffing oscillator, Nayfeh & Mook (1979), section 4.1; isotropic in psi by the fourfold symmetry of the suspension",
    signature="leaning peaks; frequency shift ~ level squared; up-sweep differs from down-sweep; third harmonic",
    parameters=(Parameter("k3", "1/(V^2 s^4)", -1e15, 1e15, "cubic stiffness, either sign", scale=1e9),),
    force=force,
    potential=potential,
    size=SizeRange(1e8, 1e12),
    plants=("gyro", "resonator"),
)
