"""Drive voltage couples into the pick-offs through leakage or shared ground."""

from __future__ import annotations

from dataclasses import replace

from ...arrays import FloatArray
from ..effect import Context, Effect
from ..parameters import Parameter
from ..readout import Readout


def readout(r: Readout, p: FloatArray, context: Context) -> Readout:
    return replace(r, resistive=r.resistive + p.reshape(r.resistive.shape))


EFFECT = Effect(
    name="resistive_feedthrough",
    law="S += R v",
    source="Ohmic leakage or a shared ground: the paper's electrical cross-coupling, section 2.2",
    signature="floor in phase with the drive at all frequencies",
    parameters=(Parameter("R", "1", -10.0, 10.0, "coupling", scale=1e-3, per="path"),),
    readout=readout,
)
