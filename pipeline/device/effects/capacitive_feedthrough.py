"""Capacitive feedthrough from the drives to the pick-offs."""

from __future__ import annotations

from dataclasses import replace

from ...arrays import FloatArray
from ..effect import Context, Effect, LookAlike, SizeRange
from ..parameters import Parameter
from ..readout import Readout

_FAR_MODE = {f"parasitic_mode.{k}": v for k, v in {"f": 8e4, "zeta": 1e-2, "b_d1": 10.0, "a": 0.0}.items()}


def readout(r: Readout, p: FloatArray, context: Context) -> Readout:
    """Add C (S, D) [s], in ``p`` row by row, to the capacitive feedthrough."""
    return replace(r, capacitive=r.capacitive + p.reshape(r.capacitive.shape))


EFFECT = Effect(
    name="capacitive_feedthrough",
    law="S += C dv/dt of the held drive, before the anti-alias filter",
    latex=r"S = \cdots + C\,\frac{dv}{dt}",
    source="displacement current of a stray capacitance, i = C dv/dt",
    signature="broadband response that grows with frequency, in quadrature with the drive; antiresonances",
    parameters=(
        Parameter(
            "C",
            "s",
            -1e-2,
            1e-2,
            "coupling capacitance times pick-off gain",
            scale=1e-7,
            per="path",
            relative_to="transfer",
        ),
    ),
    readout=readout,
    mimics_hold=True,
    # In the driven band, a mode far above it responds like a capacitance of rank one.
    look_alikes=(LookAlike(("parasitic_mode",), {"C_s1d1": 2e-8}, start=_FAR_MODE),),
    size=SizeRange(1e-7, 1e-3),
)
