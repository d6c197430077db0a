"""Tilt of the up-down mode shape about x."""

from __future__ import annotations

from dataclasses import replace

from ...arrays import FloatArray
from ..effect import Context, Effect, LookAlike, SizeRange
from ..gyro import M_D, M_S
from ..mechanics import Mechanics
from ..parameters import Parameter


def mechanics(m: Mechanics, p: FloatArray, context: Context) -> Mechanics:
    """Scale the up-down row of F and column of V by 1 - t_x (-1, 1), from the mode shape psi_x = -t_x z; p[0] = t_x [1]."""
    drive, sense = m.drive.copy(), m.velocity_sense.copy()
    drive[:, 2, :] *= 1.0 - p[0] * M_D[0]
    sense[:, :, 2] *= 1.0 - p[0] * M_S[:, 0]
    return replace(m, drive=drive, velocity_sense=sense)


EFFECT = Effect(
    name="updown_tilt",
    law="z is driven by f_z - t_x tau_x and measured as z' (1, 1) + t_x z' (1, -1)",
    latex=r"z\ \text{is driven by}\ f_z - t_x \tau_x,"
    r" \quad S = \cdots + z' \begin{pmatrix} 1 \\ 1 \end{pmatrix} + t_x z' \begin{pmatrix} 1 \\ -1 \end{pmatrix}",
    source="mode shape psi_x = -t_x z from the spring coupling K_zx = sum k y; reciprocity gives the drive side",
    signature="the residue of the up-down mode is not along (1, 1); visible only at the up-down resonance",
    parameters=(Parameter("t_x", "1", -1.0, 1.0, "rotation about x in the up-down mode", scale=0.01),),
    mechanics=mechanics,
    plants=("updown",),
    # A mismatch of the gains, with the imbalances and rocking gains adjusted, is the more general law.
    look_alikes=(LookAlike(("electrode_mismatch",), {"t_x": 3e-3}, always=True),),
    size=SizeRange(2e-3, 0.5),
)
