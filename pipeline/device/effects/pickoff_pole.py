"""The pick-off amplifiers are slow."""

from __future__ import annotations

from ...arrays import FloatArray
from ..effect import Context, Effect
from ..parameters import Parameter
from ..readout import Readout


def readout(r: Readout, p: FloatArray, context: Context) -> Readout:
    return r.with_pole(-1.0 / p[0])


EFFECT = Effect(
    name="pickoff_pole",
    law="1 / (1 + s T), both channels",
    source="gain-bandwidth limit of a transimpedance amplifier",
    signature="phase lag and fall of gain with frequency, all channels alike; next to a delay in a narrow band",
    parameters=(Parameter("T", "s", 0.0, 1e-2, "time constant", scale=1e-6),),
    readout=readout,
)
