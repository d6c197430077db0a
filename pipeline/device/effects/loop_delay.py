"""Constant loop delay."""

from __future__ import annotations

from dataclasses import replace

from ...arrays import FloatArray
from ..effect import Context, Effect, LookAlike, SizeRange
from ..parameters import Parameter
from ..readout import Readout


def readout(r: Readout, p: FloatArray, context: Context) -> Readout:
    """Add tau to the delay [s] of G(s); p (1,) = tau [s]."""
    return replace(r, delay_s=r.delay_s + p[0])


EFFECT = Effect(
    name="loop_delay",
    law="exp(-s tau) in both channels",
    latex=r"S \to e^{-s\tau} S",
    source="conversion and transport time of the data acquisition",
    signature="phase lag proportional to frequency, equal in all channels; amplitudes unchanged",
    parameters=(Parameter("tau", "s", 0.0, 1e-2, "delay", scale=1e-6),),
    readout=readout,
    mimics_hold=True,
    look_alikes=(LookAlike(("pickoff_pole",), {"tau": 2e-7}, always=True),),
    size=SizeRange(5e-7, 1e-3, signed=False),
)
