"""Electrode gains that differ between rocking and up-down motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...arrays import FloatArray
from ..effect import Context, Effect, LookAlike, SizeRange
from ..mechanics import Mechanics
from ..parameters import Parameter

_SIGN = np.array([-1.0, 1.0])


def mechanics(m: Mechanics, p: FloatArray, context: Context) -> Mechanics:
    """Scale rocking gains: columns 1, 2 of F by 1 -+ m_D/(1 -+ d), rows 1, 2 of V by 1 -+ m_S/(1 -+ s); p = (m_D, m_S) [1]."""
    d, s = np.asarray(context.plant["drive_imbalance"]), np.asarray(context.plant["sense_imbalance"])
    drive, sense = m.drive.copy(), m.velocity_sense.copy()
    ratio_d = 1.0 + _SIGN * p[0] / (1.0 + _SIGN * d[..., None])
    ratio_s = 1.0 + _SIGN * p[1] / (1.0 + _SIGN * s[..., None])
    drive[:, :2, :] *= ratio_d[..., None, :]
    sense[:, :, :2] *= ratio_s[..., :, None]
    return replace(m, drive=drive, velocity_sense=sense)


EFFECT = Effect(
    name="electrode_mismatch",
    law="imbalances: s, d up-down and s + m_S, d + m_D rocking; K_1 is scaled by 1 - imbalance, K_2 by 1 + imbalance",
    latex=r"s_\text{rocking} = s_\text{up-down} + m_S, \quad d_\text{rocking} = d_\text{up-down} + m_D",
    source="a displaced electrode has another lever arm, so its gain differs between torque and force",
    signature="channel gains of the rocking modes differ from those of the up-down mode; no new frequency, no level dependence",
    parameters=(
        Parameter("m_D", "1", -0.5, 0.5, "drive imbalance of rocking minus that of up-down", scale=0.01),
        Parameter("m_S", "1", -0.5, 0.5, "sense imbalance of rocking minus that of up-down", scale=0.01),
    ),
    mechanics=mechanics,
    plants=("updown",),
    look_alikes=(
        LookAlike(("updown_tilt",), {"m_D": 2e-3, "m_S": 2e-3}),
        LookAlike(("updown_tilt", "pickoff_crosstalk", "electrode_misalignment"), {"m_D": 2e-3, "m_S": -1e-3}),
    ),
    size=SizeRange(2e-3, 0.3),
)
