"""Parasitic resonance: one additional mode of the structure or its package."""

from __future__ import annotations

import numpy as np

from ...arrays import FloatArray
from ..effect import Context, Effect, LookAlike, SizeRange
from ..mechanics import Mechanics
from ..parameters import Parameter

#: Drive vectors [1/s] of stray modes of a gyro.  The range is wider: at a tenfold frequency a mode of the same gain has a
#: tenfold b, and one at 6 times the median frequency of a record ended at 1e3 (`test_a_mode_far_above_the_others_is_found`).
_B = (-1e3, 1e3)
_GRID = tuple(300.0 * 1.02**k for k in range(141))


def mechanics(m: Mechanics, p: FloatArray, context: Context) -> Mechanics:
    """Append w to q (n,) [V s]: f = p[0] [Hz], zeta = p[1] [1], b = p[2:2 + D] [1/s], a = p[2 + D:] (S - 1,) [deg]."""
    n, drives = m.stiffness.shape[1], m.drive.shape[2]
    omega, vector = 2.0 * np.pi * p[0], np.ones(1)
    for angle in np.deg2rad(p[2 + drives :]):
        vector = np.append(vector * np.cos(angle), np.sin(angle))
    c, g, k = (np.pad(old, ((0, 0), (0, 1), (0, 1))) for old in (m.damping, m.gyroscopic, m.stiffness))
    c[:, n, n], k[:, n, n] = 2.0 * p[1] * omega, omega**2
    drive = np.append(m.drive, np.broadcast_to(p[2 : 2 + drives], (m.drive.shape[0], 1, drives)), axis=1)
    senses = [
        np.pad(old, ((0, 0), (0, 0), (0, 1))) for old in (m.position_sense, m.velocity_sense, m.acceleration_sense)
    ]
    # Pick-offs of displacement measure omega w, those of acceleration w'' / omega, so that b has the unit 1/s for each kind.
    senses[m.derivative][:, :, n] = vector * omega ** (1 - m.derivative)
    position, velocity, acceleration = senses
    return Mechanics(c, g, k, drive, velocity, position, acceleration)


EFFECT = Effect(
    name="parasitic_mode",
    law="w'' + 2 zeta omega w' + omega^2 w = b.v,  S += (cos a, sin a) w';  f in the band of the records;"
    " with more senses ((cos a, sin a) cos a_s3, sin a_s3), and so on",
    latex=r"w'' + 2\zeta\omega w' + \omega^2 w = b \cdot v,"
    r" \quad S = \cdots + \begin{pmatrix} \cos a \\ \sin a \end{pmatrix} w'",
    source="the residue of a structural mode has rank one",
    signature="a resonance at a frequency where the plant has none, with the same sense vector for all drives",
    parameters=(
        Parameter("f", "Hz", 300.0, 1e5, "frequency", 1e3, grid=_GRID, typical=(300.0, 2500.0), relative_to="mode"),
        Parameter("zeta", "1", 1e-5, 0.5, "damping ratio", 3e-3, 1e-4, grid=(1e-3, 1e-2), typical=(5e-4, 2e-2)),
        Parameter("b", "1/s", -1e5, 1e5, "drive vector", scale=0.01, typical=_B, per="drive", relative_to="transfer"),
        Parameter("a", "deg", -90.0, 90.0, "sense angle", 45.0, grid=(-67.5, -22.5, 22.5, 67.5), per="direction"),
    ),
    mechanics=mechanics,
    look_alikes=(LookAlike(("capacitive_feedthrough",), {"f": 3e4, "zeta": 1e-2, "b_d1": 40.0, "a": 0.0}),),
    resonance=("f", "zeta"),
    size=SizeRange(1.0, 900.0),
)
