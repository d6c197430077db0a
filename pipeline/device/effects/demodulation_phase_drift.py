"""Linear drift of the phase of a demodulator during a record."""

from __future__ import annotations

import numpy as np

from ...arrays import FloatArray
from ..effect import Context, Effect, SizeRange
from ..parameters import Parameter


def sense(x: FloatArray, xd: FloatArray, s: FloatArray, t: FloatArray, p: FloatArray, context: Context) -> FloatArray:
    """s cos(phi) + s_90 sin(phi) (M, S) [V], phi = p[0] t [rad] at times t (M,) [s]; x, xd (M, S) [V s, V].

    s_90: the pick-off volts a quarter period later, from the motion, exact at omega_1.
    """
    omega, imbalance = 2.0 * np.pi * context.plant["f1_hz"], context.plant.get("sense_imbalance", 0.0)
    later = (-xd / omega, omega * x, omega * xd)[context.derivative]
    if imbalance != 0.0:
        later = later * (1.0 + np.array([-imbalance, imbalance]))
    phase = p[0] * t[:, None]
    return np.asarray(s * np.cos(phase) + later * np.sin(phase))


EFFECT = Effect(
    name="demodulation_phase_drift",
    law="phi = phi' t:  S cos(phi) + S_90 sin(phi), S_90 = omega_1 x for S = x': a lag that grows with time",
    latex=r"S \to S\cos\varphi + S_{90}\sin\varphi, \quad \varphi = \varphi' t,"
    r" \quad S_{90} = \omega_1 x\ \text{for}\ S = x'",
    source="phase error of synchronous demodulation: Saukoski, Aaltonen & Halonen, IEEE Sensors J. 7 (2007) 1639",
    signature="phase lag that grows during a record, nearly independent of frequency; amplitudes unchanged; no detuning",
    parameters=(
        Parameter("rate", "rad/s", -100.0, 100.0, "phi', rate of the phase lag", 0.0, 1e-3, relative_to="record"),
    ),
    sense=sense,
    demodulated=True,
    size=SizeRange(1e-3, 0.2),
)
