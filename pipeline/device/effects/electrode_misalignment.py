"""The drive electrodes are turned against the sense electrodes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...arrays import FloatArray
from ..effect import Context, Effect
from ..mechanics import Mechanics
from ..parameters import Parameter


def mechanics(m: Mechanics, p: FloatArray, context: Context) -> Mechanics:
    c, s = np.cos(np.deg2rad(p[0])), np.sin(np.deg2rad(p[0]))
    drive = m.drive.copy()
    drive[:, :2, :] = np.array([[c, -s], [s, c]]) @ m.drive[:, :2, :]
    return replace(m, drive=drive)


EFFECT = Effect(
    name="electrode_misalignment",
    law="torques (tau_x, tau_y) turned by phi against the sense frame",
    source="rotation of one electrode mask against the other; turning both together is a gauge of theta",
    signature="residues of the rocking modes no longer symmetric in the frame of the sense electrodes",
    parameters=(Parameter("phi", "deg", -45.0, 45.0, "angle of the drive frame against the sense frame", scale=0.1),),
    mechanics=mechanics,
    plants=("gyro",),
)
