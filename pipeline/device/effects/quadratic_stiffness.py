"""Quadratic stiffness (asymmetric springs)."""

from __future__ import annotations

import numpy as np

from ...arrays import FloatArray
from ..effect import Effect, Laws, SizeRange
from ..parameters import Parameter


def force(t: float, q: FloatArray, qd: FloatArray, u: FloatArray, p: FloatArray, laws: Laws, out: FloatArray) -> None:
    """Add -k2_i q_i^2 [V/s] to ``out`` (n,) along each axis i; q (n,) [V s], p = k2 (axes,) [1/(V s^3)]."""
    for i in range(laws.axes):
        out[i] -= p[i] * q[i] * q[i]


def potential(q: FloatArray, p: FloatArray, axes: int) -> FloatArray:
    """sum_i k2_i q_i^3 / 3 (M,) [V^2] at q (M, n) [V s]."""
    return np.asarray(np.sum(p * q[:, :axes] ** 3, axis=1) / 3.0)


EFFECT = Effect(
    name="quadratic_stiffness",
    law="psi_x'' -= k2x psi_x^2,  psi_y'' -= k2y psi_y^2",
    latex=r"\psi_x'' = \cdots - k_{2x}\,\psi_x^2, \quad \psi_y'' = \cdots - k_{2y}\,\psi_y^2",
    source="expansion of an asymmetric potential to third order: Nayfeh & Mook (1979), section 4.1",
    signature="offset and second harmonic proportional to the square of the motion; softening to second order",
    parameters=(
        Parameter("k2", "1/(V s^3)", -1e13, 1e13, "quadratic stiffness along one axis", scale=1e8, per="axis"),
    ),
    force=force,
    plants=("gyro", "resonator"),
    potential=potential,
    size=SizeRange(3e7, 1e11),
)
