"""Coulomb friction (dry friction), smooth through zero velocity."""

from __future__ import annotations

import numpy as np

from ...arrays import FloatArray
from ..effect import Effect, Laws, SizeRange
from ..parameters import Parameter


def force(t: float, q: FloatArray, qd: FloatArray, u: FloatArray, p: FloatArray, laws: Laws, out: FloatArray) -> None:
    """Add -F psi' / sqrt(|psi'|^2 + s^2) [V/s] to ``out`` (n,); qd (n,) [V], p = (F [V/s], s [V])."""
    square = p[1] * p[1]
    for i in range(laws.axes):
        square += qd[i] * qd[i]
    rate = p[0] / np.sqrt(square)
    for i in range(laws.axes):
        out[i] -= rate * qd[i]


EFFECT = Effect(
    name="coulomb_friction",
    law="psi'' -= F psi' / sqrt(|psi'|^2 + s^2),  F >= 0",
    latex=r"\psi'' = \cdots - \frac{F\,\psi'}{\sqrt{|\psi'|^2 + s^2}}, \quad F \ge 0",
    source="Coulomb's law, made smooth below the speed s: Olsson, Astrom, Canudas de Wit, Gafvert & Lischinsky, "
    "European J. Control 4 (1998) 176",
    signature="resonance peaks grow more than the level; a ring-down ends as a straight line; odd harmonics",
    parameters=(
        Parameter("F", "V/s", 0.0, 100.0, "friction of a fast motion", scale=0.03),
        # A narrower corner falls between the steps of the integrator.
        Parameter(
            "s", "V", 0.01, 10.0, "speed below which it is viscous", 0.1, 0.1, grid=(0.05, 0.2), typical=(0.05, 0.3)
        ),
    ),
    force=force,
    plants=("gyro", "resonator"),
    size=SizeRange(3e-3, 10.0, signed=False),
)
