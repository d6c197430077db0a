"""Internal resonance 1:2: a hidden mode near twice the lowest frequency, coupled by a quadratic force."""

from __future__ import annotations

import numpy as np

from ...arrays import FloatArray
from ..effect import Context, Effect, Laws, SizeRange
from ..mechanics import Mechanics, widened
from ..parameters import Parameter

_MODE = (
    Parameter("delta", "1", -0.2, 0.2, "detuning from 2 f1", scale=3e-3, grid=(-0.01, -0.003, 0.0, 0.003, 0.01)),
    Parameter("zeta", "1", 1e-5, 0.5, "damping ratio", 3e-3, 1e-3, grid=(3e-3,), typical=(1e-3, 1e-2)),
)


def mechanics(m: Mechanics, p: FloatArray, context: Context) -> Mechanics:
    """Append w to q (n,) [V s], neither driven nor sensed: omega = 2 (1 + p[1]) omega_1, zeta = p[2]."""
    n = m.stiffness.shape[1]
    wider, omega = widened(m, n + 1), 4.0 * np.pi * (1.0 + p[1]) * context.plant["f1_hz"]
    wider.damping[:, n, n], wider.stiffness[:, n, n] = 2.0 * p[2] * omega, omega**2
    return wider


def force(t: float, q: FloatArray, qd: FloatArray, u: FloatArray, p: FloatArray, laws: Laws, out: FloatArray) -> None:
    """Add -2 c w psi and -c |psi|^2 for w [V/s] to ``out`` (n,); q (n,) [V s], p[0] = c^2, p[3] the place of w."""
    w, c = int(p[3]), np.sqrt(p[0])
    for i in range(laws.axes):
        out[i] -= 2.0 * c * q[w] * q[i]
        out[w] -= c * q[i] * q[i]


def potential(q: FloatArray, p: FloatArray, axes: int) -> FloatArray:
    """c w |psi|^2 (M,) [V^2] at q (M, n) [V s]."""
    return np.asarray(np.sqrt(p[0]) * q[:, int(p[3])] * np.sum(q[:, :axes] ** 2, axis=1))


EFFECT = Effect(
    name="internal_resonance_1_2",
    law="w'' + 2 zeta omega w' + omega^2 w = -c |psi|^2,  psi'' -= 2 c w psi,  omega = 2 (1 + delta) omega_1",
    latex=r"w'' + 2\zeta\omega w' + \omega^2 w = -c\,|\psi|^2, \quad \psi'' = \cdots - 2c\,w\,\psi,"
    r" \quad \omega = 2(1 + \delta)\,\omega_1",
    source="Nayfeh & Mook, Nonlinear Oscillations (1979), chapter 6, quadratic nonlinearities; an eliminated w leaves c^2",
    signature="amplitude-dependent damping and frequency shift where twice the drive passes the hidden mode; saturation",
    parameters=(
        Parameter("c^2", "1/(V^2 s^6)", 0.0, 1e20, "square of the coupling", scale=1e14),
        *_MODE,
    ),
    mechanics=mechanics,
    force=force,
    potential=potential,
    plants=("gyro",),
    size=SizeRange(1e14, 1e19, signed=False),
)
