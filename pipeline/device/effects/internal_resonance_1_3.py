"""Internal resonance 1:3: hidden modes near three times the lowest frequency, coupled by a cubic force."""

from __future__ import annotations

import numpy as np

from ...arrays import FloatArray
from ..effect import Context, Effect, Laws, SizeRange
from ..mechanics import Mechanics, widened
from ..parameters import Parameter

_MODE = (
    Parameter("delta", "1", -0.2, 0.2, "detuning from 3 f1", scale=3e-3, grid=(-0.01, -0.003, 0.0, 0.003, 0.01)),
    Parameter("zeta", "1", 1e-5, 0.5, "damping ratio", 3e-3, 1e-3, grid=(3e-3,), typical=(1e-3, 1e-2)),
)


def mechanics(m: Mechanics, p: FloatArray, context: Context) -> Mechanics:
    """Append w (axes,) to q (n,) [V s], neither driven nor sensed: omega = 3 (1 + p[1]) omega_1, zeta = p[2]."""
    n, omega = m.stiffness.shape[1], 6.0 * np.pi * (1.0 + p[1]) * np.asarray(context.plant["f1_hz"])[..., None]
    more, w = widened(m, n + context.axes), np.arange(n, n + context.axes)
    more.damping[:, w, w], more.stiffness[:, w, w] = 2.0 * p[2] * omega, omega**2
    return more


def force(t: float, q: FloatArray, qd: FloatArray, u: FloatArray, p: FloatArray, laws: Laws, out: FloatArray) -> None:
    """Add -c (2 (w.psi) psi + |psi|^2 w) and -c |psi|^2 psi for w [V/s] to ``out`` (n,); p[0] = c^2, w = q[p[3]:] [V s]."""
    first, c, square, product = int(p[3]), np.sqrt(p[0]), 0.0, 0.0
    for i in range(laws.axes):
        square += q[i] * q[i]
        product += q[i] * q[first + i]
    for i in range(laws.axes):
        out[i] -= c * (2.0 * product * q[i] + square * q[first + i])
        out[first + i] -= c * square * q[i]


def potential(q: FloatArray, p: FloatArray, axes: int) -> FloatArray:
    """c |psi|^2 (w.psi) (M,) [V^2] at q (M, n) [V s]."""
    w = q[:, int(p[3]) :][:, :axes]
    return np.asarray(np.sqrt(p[0]) * np.sum(q[:, :axes] ** 2, axis=1) * np.sum(q[:, :axes] * w, axis=1))


EFFECT = Effect(
    name="internal_resonance_1_3",
    law="w'' + 2 zeta omega w' + omega^2 w = -c |psi|^2 psi,  omega = 3 (1 + delta) omega_1,  potential c |psi|^2 (w.psi)",
    latex=r"w'' + 2\zeta\omega w' + \omega^2 w = -c\,|\psi|^2\psi,"
    r" \quad \text{potential}\ c\,|\psi|^2 (w \cdot \psi), \quad \omega = 3(1 + \delta)\,\omega_1",
    source="Nayfeh & Mook (1979), chapter 6, cubic nonlinearities; Antonio, Zanette & Lopez, Nature Communications 3 (2012) 806",
    signature="the resonance stops growing or shifting where three times the drive passes the hidden modes",
    parameters=(Parameter("c^2", "1/(V^4 s^8)", 0.0, 1e30, "square of the coupling", scale=1e23), *_MODE),
    mechanics=mechanics,
    force=force,
    potential=potential,
    plants=("gyro",),
    size=SizeRange(1e21, 1e28, signed=False),
)
