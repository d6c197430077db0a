"""The record comes late."""

from __future__ import annotations

from dataclasses import replace

from ...arrays import FloatArray
from ..effect import Context, Effect
from ..parameters import Parameter
from ..readout import Readout


def readout(r: Readout, p: FloatArray, context: Context) -> Readout:
    return replace(r, delay_s=r.delay_s + p[0])


EFFECT = Effect(
    name="loop_delay",
    law="exp(-s tau), both channels",
    source="conversion and transport time of the data acquisition",
    signature="phase linear in frequency, all channels alike, amplitudes untouched",
    parameters=(Parameter("tau", "s", 0.0, 1e-2, "delay", scale=1e-6),),
    readout=readout,
)
