"""Offset between the clocks of the drive and of the sense converters."""

from __future__ import annotations

from dataclasses import replace

from ...arrays import FloatArray
from ..effect import Context, Effect, SizeRange
from ..parameters import Parameter
from ..readout import Readout


def readout(r: Readout, p: FloatArray, context: Context) -> Readout:
    """Add delta [ppm] to the offset [1] of the clock of the read-out; p (1,) = delta."""
    return replace(r, clock_offset=r.clock_offset + 1e-6 * p[0])


EFFECT = Effect(
    name="clock_offset",
    law="y(t (1 - delta)): a delay of delta t, t from the start of the record",
    latex=r"y(t) \to y(t - \delta t)",
    source="converters with clocks of their own: Farina, Advancements in impulse response measurements, AES 122 (2007)",
    signature="phase lag proportional to frequency and to the time since the start of the record; amplitudes unchanged",
    parameters=(Parameter("delta", "ppm", -1e3, 1e3, "relative rate of the sense clock, minus 1", scale=0.1),),
    readout=readout,
    size=SizeRange(0.1, 100.0),
)
