"""Finite bandwidth of one drive amplifier (one real pole)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...arrays import FloatArray
from ..effect import Context, Effect, LookAlike, SizeRange
from ..parameters import Parameter
from ..readout import Readout


def readout(r: Readout, p: FloatArray, context: Context) -> Readout:
    """Add T to the time constant [s] of one drive; p = (T [s], number of the drive)."""
    return replace(r, drive_time_s=r.drive_time_s + p[0] * (np.arange(r.drive_time_s.size) == round(p[1]) - 1))


EFFECT = Effect(
    name="drive_pole",
    law="1 / (1 + s T) in one drive; what both drives have in common equals the pick-off pole",
    latex=r"v_k \to \frac{v_k}{1 + sT}, \quad k\ \text{one drive}",
    source="output resistance of the amplifier and capacitance of electrode and line: Senturia (2001), section 14.2",
    signature="phase lag and gain loss of the response to one drive that grow with frequency, equal in all channels",
    parameters=(
        Parameter("T", "s", 0.0, 1e-2, "time constant", scale=1e-6),
        Parameter("drive", "1", 1.0, 2.0, "number of the drive", 1.0, grid=(1.0, 2.0), fitted=False),
    ),
    readout=readout,
    plants=("gyro",),
    look_alikes=(LookAlike(("drive_delay", "loop_delay"), {"T": 2e-7, "drive": 2.0}, always=True),),
    size=SizeRange(5e-7, 1e-4, signed=False),
)
