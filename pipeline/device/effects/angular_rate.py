"""Coriolis coupling of the rocking modes by an angular rate."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...arrays import FloatArray
from ..effect import Context, Effect, SizeRange
from ..mechanics import Mechanics
from ..parameters import Parameter


def mechanics(m: Mechanics, p: FloatArray, context: Context) -> Mechanics:
    """Add 2 Omega J to the psi block of G (B, n, n) [1/s], J = [[0, -1], [1, 0]]; p[0] = Omega [rad/s]."""
    gyroscopic = m.gyroscopic.copy()
    gyroscopic[:, :2, :2] += 2.0 * p[0] * np.array([[0.0, -1.0], [1.0, 0.0]])
    return replace(m, gyroscopic=gyroscopic)


EFFECT = Effect(
    name="angular_rate",
    law="psi'' += -2 Omega I_p/I_0p [[0, -1], [1, 0]] psi'",
    latex=r"\psi'' = \cdots - 2\,\Omega\,\frac{I_p}{I_{0p}} \begin{pmatrix} 0 & -1 \\ 1 & 0 \end{pmatrix} \psi'",
    source="the paper, eq. (2)",
    signature="antisymmetric cross-channel response (H12 - H21) at the rocking resonances",
    parameters=(
        Parameter(
            "Omega", "rad/s", -100.0, 100.0, "rate times angular gain I_p/I_0p", scale=0.1, relative_to="absolute"
        ),
    ),
    mechanics=mechanics,
    plants=("gyro",),
    condition="rate",
    size=SizeRange(7e-3, 50.0),
)
