"""Off-diagonal damping c12 in the stiffness axes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ...arrays import FloatArray
from ..effect import Context, Effect, SizeRange
from ..mechanics import Mechanics
from ..parameters import Parameter


def mechanics(m: Mechanics, p: FloatArray, context: Context) -> Mechanics:
    """Add c12 [[-sin 2theta, cos 2theta], [cos 2theta, sin 2theta]] to C (B, n, n) [1/s]; p[0] = c12 [1/s]."""
    double = np.deg2rad(2.0 * np.asarray(context.plant["theta_deg"]))
    rotated = np.array([[-np.sin(double), np.cos(double)], [np.cos(double), np.sin(double)]])
    damping = m.damping.copy()
    damping[:, :2, :2] += p[0] * np.moveaxis(rotated, (0, 1), (-2, -1))
    return replace(m, damping=damping)


def _passive(plant: Mapping[str, float]) -> float:
    c11, c22 = (4.0 * np.pi * plant[f"f{i}_hz"] * plant[f"zeta{i}"] for i in (1, 2))
    return float(0.9 * np.sqrt(c11 * c22))


EFFECT = Effect(
    name="offdiagonal_damping",
    law="C = Q^T [[c11, c12], [c12, c22]] Q, Q the principal axes of K; |c12| <= sqrt(c11 c22)",
    latex=r"C = Q^T \begin{pmatrix} c_{11} & c_{12} \\ c_{12} & c_{22} \end{pmatrix} Q,"
    r" \quad |c_{12}| \le \sqrt{c_{11} c_{22}}",
    source="the paper, eq. (2) and section 5.1",
    signature="reciprocal cross-channel response in quadrature at the rocking resonances",
    parameters=(
        Parameter("c12", "1/s", -100.0, 100.0, "off-diagonal damping in the stiffness axes", quantity="c12_per_s"),
    ),
    mechanics=mechanics,
    plants=("gyro",),
    size=SizeRange(0.02, _passive),
)
