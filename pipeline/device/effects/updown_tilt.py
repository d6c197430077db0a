"""The up-down mode tilts as it moves."""

from __future__ import annotations

from dataclasses import replace

from ...arrays import FloatArray
from ..effect import Context, Effect
from ..gyro import M_D, M_S
from ..mechanics import Mechanics
from ..parameters import Parameter


def mechanics(m: Mechanics, p: FloatArray, context: Context) -> Mechanics:
    drive, sense = m.drive.copy(), m.velocity_sense.copy()
    drive[:, 2, :] *= 1.0 - p[0] * M_D[0]
    sense[:, :, 2] *= 1.0 - p[0] * M_S[:, 0]
    return replace(m, drive=drive, velocity_sense=sense)


EFFECT = Effect(
    name="updown_tilt",
    law="z is driven by f_z - t_x tau_x and seen as z' (1, 1) + t_x z' (1, -1)",
    source="mode shape psi_x = -t_x z from K_zx = sum k y of the springs; reciprocity fixes the drive side",
    signature="the up-down residue is no longer along (1, 1); only at the up-down resonance",
    parameters=(Parameter("t_x", "1", -1.0, 1.0, "rotation about x in the up-down mode", scale=0.01),),
    mechanics=mechanics,
    plants=("gyro",),
)
