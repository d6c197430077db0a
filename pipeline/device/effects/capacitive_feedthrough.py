"""Drive voltage couples into the pick-offs through stray capacitance."""

from __future__ import annotations

from dataclasses import replace

from ...arrays import FloatArray
from ..effect import Context, Effect
from ..parameters import Parameter
from ..readout import Readout


def readout(r: Readout, p: FloatArray, context: Context) -> Readout:
    return replace(r, capacitive=r.capacitive + p.reshape(r.capacitive.shape))


EFFECT = Effect(
    name="capacitive_feedthrough",
    law="S += C dv/dt of the held drive, through the filter",
    source="displacement current of a stray capacitance, i = C dv/dt",
    signature="floor that grows with frequency, in quadrature with the drive; antiresonances",
    parameters=(Parameter("C", "s", -1e-2, 1e-2, "coupling", scale=1e-7, per="path"),),
    readout=readout,
)
