"""Estimate, standard deviation and 90 % interval of each quantity from posterior draws.

A quantity on the line: median, sd, 5 % and 95 % quantiles.  An axis (theta, modulo 180 deg): deviations from the axial
mean  1/2 arg <exp(2 i theta)>  are treated on the line and turned back, so the interval is an arc that runs from q05 up
to q95 modulo 180.

Shapes: draws (n,) a quantity; units as the quantity's.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ...arrays import FloatArray
from ...axial import wrap
from ...quantities import AXES


def summarise(draws: Mapping[str, FloatArray]) -> dict[str, float]:
    """<q>, <q>_sd, <q>_q05, <q>_q95 of every quantity in ``draws``; nan where the draws are."""
    names = list(draws)
    lines = np.stack([draws[name] for name in names])
    centre = np.zeros(len(names))
    for i, name in enumerate(names):
        if name in AXES:
            centre[i] = np.rad2deg(np.angle(np.mean(np.exp(2j * np.deg2rad(lines[i]))))) / 2.0
            lines[i] = wrap(lines[i] - centre[i])
    found = np.quantile(lines, [0.05, 0.5, 0.95], axis=1) + centre
    sd = np.std(lines, axis=1)
    out: dict[str, float] = {}
    for i, name in enumerate(names):
        q05, q50, q95 = wrap(found[:, i]) if name in AXES else found[:, i]
        out |= {name: float(q50), f"{name}_sd": float(sd[i]), f"{name}_q05": float(q05), f"{name}_q95": float(q95)}
    return out
