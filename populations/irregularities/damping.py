"""Spread of the gas and anchor losses at a given pressure.

    1/Q = (p / p0) exp(x_gas) / Q_gas + exp(x_anchor) / Q_anchor + 1 / Q_thermoelastic

p is the pressure around the device and p_0 the nominal one.  x_gas and x_anchor are normal.  x_gas of rocking and x_gas of
up-down are correlated, because the gaps and the gas are the same.  1/Q_gas is the nominal 1/Q minus the other two losses.

Source: free-molecular damping is proportional to p; losses add; reported spread of packaged Q: 11 % (1800 +-200 at 200 mTorr).
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from pipeline.arrays import FloatArray

from ..irregularity import Change, Irregularity, IrregularityParameter
from ..site import Site


def act(p: Mapping[str, float], site: Site) -> Change:
    """ln_gas (2, B) [1] of rocking and up-down, ln_anchor (B,) [1]."""
    rho = p["correlation"]

    def pair(normals: FloatArray) -> FloatArray:
        return np.stack([normals[0], rho * normals[0] + math.sqrt(1.0 - rho * rho) * normals[1]])

    gas = p["lot"] * pair(site.normal("lot", 2)) + p["wafer"] * pair(site.normal("wafer", 2))
    return Change(
        ln_gas=gas + p["die"] * pair(site.normal("die", 2)),
        ln_anchor=p["anchor"] * site.normal("die", label="anchor")[0],
    )


IRREGULARITY = Irregularity(
    name="damping",
    stage="fabrication",
    parameters=(
        IrregularityParameter("lot", "1", 0.0, 2.0, "sd of ln(gas damping) from lot to lot"),
        IrregularityParameter("wafer", "1", 0.0, 2.0, "sd of ln(gas damping) from wafer to wafer in a lot"),
        IrregularityParameter("die", "1", 0.0, 2.0, "sd of ln(gas damping) from die to die"),
        IrregularityParameter("anchor", "1", 0.0, 2.0, "sd of ln(anchor loss) from die to die"),
        IrregularityParameter("correlation", "1", -1.0, 1.0, "correlation of rocking and up-down at each level"),
    ),
    source="losses add, gas damping proportional to pressure; magnitudes from the reported spread of packaged Q",
    act=act,
    latex=r"\frac{1}{Q} = \frac{p}{p_0}\,\frac{e^{x_\text{gas}}}{Q_\text{gas}}"
    r" + \frac{e^{x_\text{anchor}}}{Q_\text{anchor}} + \frac{1}{Q_\text{thermoelastic}}",
)
