"""Deviation of a film thickness or of an etched width across a wafer.

    delta(x, y) = lot + wafer + bow b (rho^2 - 1/2) + wedge . (x, y) / R + N(x, y) + die,   rho^2 = (x^2 + y^2) / R^2

lot, wafer and die are normal; b ~ N(1, bow_spread) for each wafer; wedge is a normal vector; N is a Gaussian process with
correlation exp(-d / length).  The deviation is evaluated at every spring: a gradient across the device tilts its up-down mode
(1-theta), and a curvature splits its rocking modes slightly (2-theta).

Shapes: B devices, J springs.
Source: variance shares lot / wafer / within wafer 73/20/7 % (Oxide data of R's nlme) and 47/34/18 % (NIST handbook, ppc514).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pipeline.arrays import FloatArray

from .irregularity import IrregularityParameter
from .site import Site

#: The right-hand side of the equation, for the manual.
LATEX = r"\mu_\text{lot} + \mu_\text{wafer} + b\,(\rho^2 - 1/2) + w_x x + w_y y + N(x, y) + \mu_\text{die}"


def across_wafer_parameters(unit: str, suffix: str, high: float) -> tuple[IrregularityParameter, ...]:
    """Parameters of the deviation; spreads are in ``unit``, between 0 and ``high``, and their names end in ``suffix``."""

    def spread(name: str, meaning: str, low: float = 0.0) -> IrregularityParameter:
        return IrregularityParameter(f"{name}_{suffix}", unit, low, high, meaning)

    return (
        spread("lot", "sd of the lot mean"),
        spread("wafer", "sd of the wafer mean within a lot"),
        spread("bow", "radial bow, edge minus centre", low=-high),
        IrregularityParameter("bow_spread", "1", 0.0, 10.0, "sd of the bow of the wafers over its mean"),
        spread("wedge", "sd of each component of the gradient, centre to edge"),
        spread("field", "sd of the smooth random field on a wafer"),
        IrregularityParameter("field_length_mm", "mm", 0.1, 1e4, "correlation length of the random field", null=15.0),
        spread("die", "sd from die to die"),
    )


def across_wafer(p: Mapping[str, float], suffix: str, site: Site) -> FloatArray:
    """delta (J, B) at each spring, in the unit of the spreads in ``p``."""
    x, y = site.spring_places()
    level = p[f"lot_{suffix}"] * site.normal("lot")[0] + p[f"wafer_{suffix}"] * site.normal("wafer")[0]
    bow = p[f"bow_{suffix}"] * (1.0 + p["bow_spread"] * site.normal("wafer", label="bow")[0])
    wedge = p[f"wedge_{suffix}"] * site.normal("wafer", 2, "wedge")
    local = p[f"field_{suffix}"] * site.field(p["field_length_mm"]) + p[f"die_{suffix}"] * site.normal("die")[0]
    pattern: FloatArray = bow * (x * x + y * y - 0.5) + (wedge[0] * x + wedge[1] * y)
    return np.asarray(pattern + (level + local))
