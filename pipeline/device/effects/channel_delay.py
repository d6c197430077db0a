"""Delay between the channels of the read-out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...arrays import FloatArray
from ..effect import Context, Effect, SizeRange
from ..parameters import Parameter
from ..readout import Readout


def readout(r: Readout, p: FloatArray, context: Context) -> Readout:
    """Add -tau/2 and tau/2 to the delays [s] of channels 1 and 2; p (1,) = tau [s]."""
    return replace(r, channel_delay_s=r.channel_delay_s + p[0] * np.array([-0.5, 0.5]))


EFFECT = Effect(
    name="channel_delay",
    law="exp(s tau/2) in channel 1, exp(-s tau/2) in channel 2;  their mean is the loop delay",
    latex=r"S_1 \to e^{s\tau/2} S_1, \quad S_2 \to e^{-s\tau/2} S_2",
    source="channels sampled one after the other by one converter: Jenq, IEEE Trans. Instrum. Meas. 37 (1988) 245",
    signature="phase between the channels proportional to frequency, equal for all drives; amplitudes unchanged",
    parameters=(Parameter("tau", "s", -1e-3, 1e-3, "delay of channel 2 after channel 1", scale=1e-6),),
    readout=readout,
    plants=("gyro",),
    size=SizeRange(1e-6, 1e-4),
)
