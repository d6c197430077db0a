"""Finite bandwidth of the pick-off amplifiers (one real pole)."""

from __future__ import annotations

from ...arrays import FloatArray
from ..effect import Context, Effect, LookAlike, SizeRange
from ..parameters import Parameter
from ..readout import Readout


def readout(r: Readout, p: FloatArray, context: Context) -> Readout:
    """G(s) / (1 + s T); p (1,) = T [s]."""
    return r.with_pole(-1.0 / p[0])


EFFECT = Effect(
    name="pickoff_pole",
    law="1 / (1 + s T) in both channels",
    latex=r"S \to \frac{S}{1 + sT}",
    source="gain-bandwidth limit of a transimpedance amplifier",
    signature="phase lag and gain loss that grow with frequency, equal in all channels; in a narrow band like a delay",
    parameters=(Parameter("T", "s", 0.0, 1e-2, "time constant", scale=1e-6),),
    readout=readout,
    mimics_hold=True,
    look_alikes=(LookAlike(("loop_delay",), {"T": 2e-7}, always=True),),
    size=SizeRange(5e-7, 1e-3, signed=False),
)
