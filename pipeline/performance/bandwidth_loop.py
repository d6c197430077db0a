"""The loop of ``figures/bandwidth_hz``, which has the equations.

Compiled: as arrays, fifty of the draws of a device would be made and read again.
"""

from __future__ import annotations

import math

from numba import njit

from ..arrays import FloatArray

#: Each step multiplies the error by about split / frequency; two leave 1e-6 of the bandwidth at a split of 1 %.
_STEPS = 2


@njit(cache=True, error_model="numpy")
def _response(omega0: float, d: float, c2: float, nu: float) -> float:
    """|G(nu) / G(0)|^2 [1] at a rate that varies with nu [rad/s].

    With j / H = a + j c above omega0, b + j c below it and D + j c at it, this is
    [(D (a + b) + 2 c^2)^2 + c^2 (a - b)^2] / [4 (a^2 + c^2)(b^2 + c^2)].
    """
    # (omega_s^2 - omega^2) / omega without cancellation of the split.
    a = (omega0 * d - nu * (2.0 * omega0 + nu)) / (omega0 + nu)
    b = (omega0 * d + nu * (2.0 * omega0 - nu)) / (omega0 - nu)
    along, across = d * (a + b) + 2.0 * c2, a - b
    return (along * along + c2 * across * across) / (4.0 * (a * a + c2) * (b * b + c2))


# Without contraction: a device of a batch has the value that it has alone.
@njit(cache=True, error_model="numpy")
def bandwidth(omega0: FloatArray, detuning: FloatArray, damping: FloatArray, out: FloatArray) -> None:
    """Fill ``out`` (n,) with nu [rad/s], of (n,) each [rad/s]."""
    for n in range(out.size):
        d, c2 = detuning[n], damping[n] * damping[n]
        delta2, gamma2 = 0.25 * d * d, 0.25 * c2
        whole = delta2 + gamma2
        half = 4.0 * whole - 7.0 * gamma2
        root = half * half - 8.0 * whole * whole
        peaked = half > 0.0 and root >= 0.0
        rising = 2.0 * whole * whole / (half + math.sqrt(max(root, 0.0)))
        falling = delta2 + math.sqrt(delta2 * delta2 + whole * whole)
        x, level = (rising, 2.0) if peaked else (falling, 0.5)
        nu = math.sqrt(x)
        # d ln |G/G(0)|^2 / d ln nu of the approximation at its root.
        away = whole - x
        slope = (
            2.0
            * x
            * (gamma2 / (whole * whole + gamma2 * x) + (2.0 * away - 4.0 * gamma2) / (away * away + 4.0 * gamma2 * x))
        )
        for _ in range(_STEPS):
            step = (1.0 - _response(omega0[n], d, c2, nu) / level) / slope
            # Where the peak just reaches +3 dB the slope vanishes; the approximation is kept there.
            nu = nu * (1.0 + step) if abs(step) < 0.1 else nu
        out[n] = nu
