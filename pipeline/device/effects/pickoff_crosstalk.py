"""Crosstalk between the pick-off channels."""

from __future__ import annotations

import numpy as np

from ...arrays import FloatArray
from ..effect import Context, Effect, SizeRange
from ..parameters import Parameter
from ..readout import Readout


def readout(r: Readout, p: FloatArray, context: Context) -> Readout:
    """G(s) [[1, a], [b, 1]]; p = (a, b) [1]."""
    return r.through(np.array([[1.0, p[0]], [p[1], 1.0]]))


EFFECT = Effect(
    name="pickoff_crosstalk",
    law="S <- (1 + [[0, a], [b, 0]]) S",
    latex=r"S \to \begin{pmatrix} 1 & a \\ b & 1 \end{pmatrix} S",
    source="capacitive or inductive coupling between the two pick-off amplifiers, independent of frequency",
    signature="a copy of one channel in the other, equal for all modes and for feedthrough",
    parameters=(
        Parameter("a", "1", -0.9, 0.9, "from channel 2 to channel 1", scale=0.01),
        Parameter("b", "1", -0.9, 0.9, "from channel 1 to channel 2", scale=0.01),
    ),
    readout=readout,
    plants=("gyro",),
    size=SizeRange(1e-3, 0.5),
)
