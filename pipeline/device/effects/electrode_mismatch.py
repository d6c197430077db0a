"""Rocking sees other electrode gains than up-down does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...arrays import FloatArray
from ..effect import Context, Effect
from ..mechanics import Mechanics
from ..parameters import Parameter

_SIGN = np.array([-1.0, 1.0])


def mechanics(m: Mechanics, p: FloatArray, context: Context) -> Mechanics:
    d, s = np.asarray(context.plant["drive_imbalance"]), np.asarray(context.plant["sense_imbalance"])
    drive, sense = m.drive.copy(), m.velocity_sense.copy()
    ratio_d = 1.0 + _SIGN * p[0] / (1.0 + _SIGN * d[..., None])
    ratio_s = 1.0 + _SIGN * p[1] / (1.0 + _SIGN * s[..., None])
    drive[:, :2, :] *= ratio_d[..., None, :]
    sense[:, :, :2] *= ratio_s[..., :, None]
    return replace(m, drive=drive, velocity_sense=sense)


EFFECT = Effect(
    name="electrode_mismatch",
    law="up-down sees the imbalances s, d; rocking s + m_S, d + m_D; K_1 goes with 1 -, K_2 with 1 +",
    source="an electrode whose centre is displaced has another lever arm, so another gain for torque than for force",
    signature="gains of the rocking modes differ from those of the up-down mode; no new frequency, no level dependence",
    parameters=(
        Parameter("m_D", "1", -0.5, 0.5, "mismatch of the drive electrodes", scale=0.01),
        Parameter("m_S", "1", -0.5, 0.5, "mismatch of the sense electrodes", scale=0.01),
    ),
    mechanics=mechanics,
    plants=("gyro",),
)
