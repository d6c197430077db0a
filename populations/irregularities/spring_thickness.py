"""Thickness of the springs (SOI layer or wafer thinning): shifts all modes by the same ratio.

    k = E w t^3 / L^3   =>   d ln k = 3 ln(1 + dt/t),   f ~ t^1.5 at fixed inertia

E is Young's modulus of the spring, w its width, t its thickness and L its length.  The deviation dt has a mean of each lot and
wafer, a radial bow b, a wedge, a smooth random field N and a value of each die.  rho, x and y are in wafer radii.

Source: fixed-guided beam, out of plane (derivation); SOI layer 25 +-1 um, total thickness variation of bulk wafers below 5 um.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..across_wafer import LATEX, across_wafer, across_wafer_parameters
from ..irregularity import Change, Irregularity
from ..site import Site


def act(p: Mapping[str, float], site: Site) -> Change:
    """ln_spring (J, B) [1] = 3 ln(1 + dt/t)."""
    return Change(ln_spring=3.0 * np.log1p(0.01 * across_wafer(p, "pct", site)))


IRREGULARITY = Irregularity(
    name="spring_thickness",
    stage="fabrication",
    parameters=across_wafer_parameters("% of t", "pct", 5.0),
    source="k = E w t^3 / L^3; SOI layer tolerance 25 +-1 um; shares by level as in populations/across_wafer.py",
    act=act,
    latex=r"\begin{align*} \Delta \ln k_j &= 3 \ln (1 + \Delta t / t), \quad k_j = \frac{E\,w\,t^3}{L^3} \\ \Delta t &= "
    + LATEX
    + r" \end{align*}",
)
