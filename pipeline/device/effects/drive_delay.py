"""Delay between the drives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...arrays import FloatArray
from ..effect import Context, Effect, SizeRange
from ..parameters import Parameter
from ..readout import Readout


def readout(r: Readout, p: FloatArray, context: Context) -> Readout:
    """Add -tau/2 and tau/2 to the delays [s] of drives 1 and 2; p (1,) = tau [s]."""
    return replace(r, drive_delay_s=r.drive_delay_s + p[0] * np.array([-0.5, 0.5]))


EFFECT = Effect(
    name="drive_delay",
    law="exp(s tau/2) for drive 1, exp(-s tau/2) for drive 2;  their mean is the loop delay",
    latex=r"v_1 \to e^{s\tau/2} v_1, \quad v_2 \to e^{-s\tau/2} v_2",
    source="converters that are updated one after the other; a delay of both drives equals one of the read-out",
    signature="phase between the responses to the drives proportional to frequency, equal in all channels",
    parameters=(Parameter("tau", "s", -1e-3, 1e-3, "delay of drive 2 after drive 1", scale=1e-6),),
    readout=readout,
    plants=("gyro",),
    size=SizeRange(1e-6, 1e-4),
)
