"""Estimate, standard deviation and 90 % interval of each quantity from posterior draws.

A quantity on the line: median, sd, 5 % and 95 % quantiles.  An axis (theta, modulo 180 deg): deviations from the axial
mean  1/2 arg <exp(2 i theta)>  are treated on the line and turned back, so the interval is an arc that runs from q05 up
to q95 modulo 180.

Shapes: draws (n,) a quantity; units as the quantity's.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..arrays import FloatArray
from ..quantities import AXES


def wrap_axis_deg(angle_deg: FloatArray) -> FloatArray:
    """The same axis in (-90, 90] deg."""
    return np.asarray(90.0 - np.mod(90.0 - angle_deg, 180.0))


def summarise(draws: Mapping[str, FloatArray]) -> dict[str, float]:
    """<q>, <q>_sd, <q>_q05, <q>_q95 of every quantity in ``draws``; nan where the draws are."""
    out: dict[str, float] = {}
    for name, values in draws.items():
        centre = 0.0
        line = values
        if name in AXES:
            centre = float(np.rad2deg(np.angle(np.mean(np.exp(2j * np.deg2rad(values)))))) / 2.0
            line = wrap_axis_deg(values - centre)
        q05, q50, q95 = np.quantile(line, [0.05, 0.5, 0.95])
        found = np.array([q50, q05, q95]) + centre
        if name in AXES:
            found = wrap_axis_deg(found)
        out[name], out[f"{name}_q05"], out[f"{name}_q95"] = (float(v) for v in found)
        out[f"{name}_sd"] = float(np.std(line))
    return out
