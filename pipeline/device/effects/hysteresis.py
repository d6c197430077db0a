"""Hysteresis of the suspension (Bouc-Wen)."""

from __future__ import annotations

from ...arrays import FloatArray
from ..effect import Effect, Laws, SizeRange
from ..parameters import Parameter


def force(t: float, q: FloatArray, qd: FloatArray, u: FloatArray, p: FloatArray, laws: Laws, out: FloatArray) -> None:
    """Add -k h_i [V/s] and h_i' [V] to ``out`` (n,); memories h_i = qd[p[2] + i] [V s], p = (k [1/s^2], r [V s], place)."""
    first = int(p[2])
    for i in range(laws.axes):
        # |h| <= r by its law; a step of the integrator that is too long for r would leave the range and diverge.
        h, s = 0.5 * (abs(qd[first + i] + p[1]) - abs(qd[first + i] - p[1])), qd[i]
        out[i] -= p[0] * h
        out[first + i] += s - 0.5 * (abs(s) * h + s * abs(h)) / p[1]


EFFECT = Effect(
    name="hysteresis",
    law="psi_i'' -= k h_i,  h_i' = psi_i' - (|psi_i'| h_i + psi_i' |h_i|)/(2 r),  k >= 0",
    latex=r"\psi_i'' = \cdots - k h_i, \quad h_i' = \psi_i' - \frac{|\psi_i'|\,h_i + \psi_i'\,|h_i|}{2r},"
    r" \quad k \ge 0",
    source="Wen, J. Engineering Mechanics Division ASCE 102 (1976) 249, with n = 1: elastic up to r, then a constant force k r",
    signature="softer and more damped resonances from a motion of r on, less so far above; odd harmonics",
    parameters=(
        Parameter("k", "1/s^2", 0.0, 1e7, "stiffness before it yields", scale=1e3),
        # A shorter reach yields within one step of the integrator.
        Parameter("r", "V s", 2e-5, 1e-2, "reach of the motion before it yields", 1e-4, 1e-4, grid=(5e-5, 2e-4)),
    ),
    force=force,
    memories=1,
    plants=("gyro", "resonator"),
    size=SizeRange(30.0, 1e5, signed=False),
)
