"""Rotation of the drive electrodes relative to the sense electrodes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...arrays import FloatArray
from ..effect import Context, Effect, LookAlike, SizeRange
from ..mechanics import Mechanics
from ..parameters import Parameter


def mechanics(m: Mechanics, p: FloatArray, context: Context) -> Mechanics:
    """Rotate the rocking rows of F (B, n, D) [1/s] by p[0] = phi [deg]."""
    c, s = np.cos(np.deg2rad(p[0])), np.sin(np.deg2rad(p[0]))
    drive = m.drive.copy()
    drive[:, :2, :] = np.array([[c, -s], [s, c]]) @ m.drive[:, :2, :]
    return replace(m, drive=drive)


EFFECT = Effect(
    name="electrode_misalignment",
    law="torques (tau_x, tau_y) rotated by phi relative to the sense frame",
    latex=r"\begin{pmatrix} \tau_x \\ \tau_y \end{pmatrix} \to \begin{pmatrix} \cos\varphi & -\sin\varphi \\"
    r" \sin\varphi & \cos\varphi \end{pmatrix} \begin{pmatrix} \tau_x \\ \tau_y \end{pmatrix}",
    source="misalignment of the two electrode masks; a rotation of both together is a gauge freedom of theta",
    signature="the residues of the rocking modes are not symmetric in the frame of the sense electrodes",
    parameters=(Parameter("phi", "deg", -45.0, 45.0, "angle from the sense frame to the drive frame", scale=0.1),),
    mechanics=mechanics,
    plants=("gyro",),
    # Apart from theta, it is an opposite rotation of the sense electrodes: crosstalk a = -b; the mismatch restores up-down.
    look_alikes=(LookAlike(("pickoff_crosstalk", "electrode_mismatch"), {"phi": 4.0}),),
    size=SizeRange(0.1, 20.0),
)
