"""Bandwidth of the rate response in open loop, from the split and the damping of the free mode.

A rate Omega cos(nu t) modulates the Coriolis force, so the free mode sees omega0 +- nu.  Demodulated in the phase in which a
constant rate appears, with the transfer function H(omega) = j omega / (omega_s^2 - omega^2 + j omega c),

    G(nu) = 1/2 [H(omega0 + nu) exp(-j phi) + conj H(omega0 - nu) exp(j phi)],       phi = arg H(omega0)

Near resonance, with the split Delta, gamma = c/2 and R = Delta^2 + gamma^2,

    |G/G(0)|^2 = (R^2 + gamma^2 x) / [(R - x)^2 + 4 gamma^2 x],    x = nu^2

Where the peak at nu = Delta reaches +3 dB, the band ends at the smaller root of  2 x^2 + (7 gamma^2 - 4 R) x + R^2 = 0  (0.54
Delta for a high Q), else at -3 dB, x = Delta^2 + sqrt(Delta^4 + R^2) (gamma for equal modes).  Newton steps on the exact |G|,
with the slope of the approximation, remove what it costs, of the order of split / frequency.

Compiled: as arrays, fifty of the draws of a device would be made and read again.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from ...arrays import FloatArray
from ..figure import Figure
from ..open_loop import TAU, OpenLoop

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
def _bandwidth(omega0: FloatArray, detuning: FloatArray, damping: FloatArray, out: FloatArray) -> None:
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


def value(gyro: OpenLoop) -> FloatArray:
    """nu / 2 pi [Hz] at which |G(nu)/G(0)| first leaves -3 dB to +3 dB."""
    omega0, detuning, damping = np.broadcast_arrays(gyro.omega0, gyro.detuning, gyro.damping)
    out = np.empty(omega0.shape)
    _bandwidth(omega0.ravel(), detuning.ravel(), damping.ravel(), out.ravel())
    return out / TAU


FIGURE = Figure(
    name="bandwidth_hz",
    unit="Hz",
    meaning="frequency of a rate at which the open-loop response first differs from that to a constant rate by 3 dB, up or down",
    label="open-loop bandwidth",
    formula="|G(nu)/G(0)|^2 = 2 or 1/2, G = 1/2 [H(omega0+nu) e^-j phi + conj H(omega0-nu) e^j phi]; 0.54 split at high Q",
    source="the paper, eq. (2), with a modulated rate; 0.54 split: Acar, Shkel: MEMS Vibratory Gyroscopes (2009), ch. 2",
    needs=(),
    value=value,
)
