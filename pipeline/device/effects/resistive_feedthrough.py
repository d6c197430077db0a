"""Resistive feedthrough from the drives to the pick-offs."""

from __future__ import annotations

from dataclasses import replace

from ...arrays import FloatArray
from ..effect import Context, Effect, SizeRange
from ..parameters import Parameter
from ..readout import Readout


def readout(r: Readout, p: FloatArray, context: Context) -> Readout:
    """Add R (S, D) [1], in ``p`` row by row, to the resistive feedthrough."""
    return replace(r, resistive=r.resistive + p.reshape(r.resistive.shape))


EFFECT = Effect(
    name="resistive_feedthrough",
    law="S += R v",
    latex=r"S = \cdots + R\,v",
    source="ohmic leakage or a shared ground: electrical cross-coupling, the paper, section 2.2",
    signature="broadband response in phase with the drive, independent of frequency",
    parameters=(Parameter("R", "1", -10.0, 10.0, "coupling gain", scale=1e-3, per="path", relative_to="transfer"),),
    readout=readout,
    mimics_hold=True,
    size=SizeRange(3e-4, 1.0),
)
