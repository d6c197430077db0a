"""Finite bandwidth of one pick-off amplifier (one real pole)."""

from __future__ import annotations

from ...arrays import FloatArray
from ..effect import Context, Effect, LookAlike, SizeRange
from ..parameters import Parameter
from ..readout import Readout


def readout(r: Readout, p: FloatArray, context: Context) -> Readout:
    """G(s) / (1 + s T) in one channel; p = (T [s], number of the channel)."""
    return r.with_pole(-1.0 / p[0], round(p[1]) - 1)


EFFECT = Effect(
    name="channel_pole",
    law="1 / (1 + s T) in one channel; what both channels have in common is the pick-off pole",
    latex=r"S_k \to \frac{S_k}{1 + sT}, \quad k\ \text{one channel}",
    source="gain-bandwidth limit of a transimpedance amplifier; amplifiers differ by their feedback capacitance",
    signature="phase lag and gain loss of one channel that grow with frequency, equal for all drives",
    parameters=(
        Parameter("T", "s", 0.0, 1e-2, "time constant", scale=1e-6),
        Parameter("channel", "1", 1.0, 2.0, "number of the channel", 1.0, grid=(1.0, 2.0), fitted=False),
    ),
    readout=readout,
    plants=("gyro",),
    look_alikes=(LookAlike(("channel_delay", "loop_delay"), {"T": 2e-7, "channel": 2.0}, always=True),),
    size=SizeRange(5e-7, 1e-4, signed=False),
)
