"""Bandwidth of the rate response in open loop, from the split and the damping of the free mode.

A rate Omega cos(nu t) modulates the Coriolis force, so the free mode sees omega0 +- nu.  Demodulated in the phase in which a
constant rate appears, with the transfer function H(omega) = j omega / (omega_s^2 - omega^2 + j omega c),

    G(nu) = 1/2 [H(omega0 + nu) exp(-j phi) + conj H(omega0 - nu) exp(j phi)],       phi = arg H(omega0)

Near resonance, with the split Delta, gamma = c/2 and R = Delta^2 + gamma^2,

    |G/G(0)|^2 = (R^2 + gamma^2 x) / [(R - x)^2 + 4 gamma^2 x],    x = nu^2

Where the peak at nu = Delta reaches +3 dB, the band ends at the smaller root of  2 x^2 + (7 gamma^2 - 4 R) x + R^2 = 0  (0.54
Delta for a high Q), else at -3 dB, x = Delta^2 + sqrt(Delta^4 + R^2) (gamma for equal modes).  Newton steps on the exact |G|,
with the slope of the approximation, remove what it costs, of the order of split / frequency.
"""

from __future__ import annotations

import numpy as np

from ...arrays import FloatArray
from ..figure import Figure
from ..open_loop import TAU, OpenLoop


def value(gyro: OpenLoop) -> FloatArray:
    """nu / 2 pi [Hz] at which |G(nu)/G(0)| first leaves -3 dB to +3 dB."""
    from ..bandwidth_loop import bandwidth  # numba takes a quarter of a second, also where no draws are read

    omega0, detuning, damping = np.broadcast_arrays(gyro.omega0, gyro.detuning, gyro.damping)
    out = np.empty(omega0.shape)
    bandwidth(omega0.ravel(), detuning.ravel(), damping.ravel(), out.ravel())
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
